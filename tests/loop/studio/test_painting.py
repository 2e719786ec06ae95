"""Painted pixels reach the light, where the library says that they shine; what is painted is an edit like any other."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from luxloop import load, prepare
from luxloop.loop.studio.sources import Source
from luxloop.world.frames import inverse, transform
from luxloop.world.light.emitters import wall_illuminance
from tests.loop.studio.clients import Arrays, Watcher, watching
from tests.loop.studio.conftest import Served, serving

BARE = ("renderer=raycast", "camera.width_px=320", "camera.height_px=180", "camera.oversampling=1", "steps=40", "functions={}", "checks={}")
MODEL, SIZE = "idealised-332x1024", (332, 1024)  # pixels that are finer than what is wanted


@pytest.fixture(scope="module")
def served(page_folder: Path) -> Iterator[Served]:
    yield from serving(Source("gfhb", (*BARE, f"headlight.model={MODEL}")), page_folder)


@pytest.fixture
def bare(editor: Watcher) -> Watcher:
    """Where nothing is painted."""
    editor.set("lighting.painted=[]")
    return editor


def spot(rows: int, cols: int, value: int = 255) -> Arrays:
    return {"value": np.full((rows, cols), value, np.uint8), "painted": np.full((rows, cols), 255, np.uint8)}


def paint(watcher: Watcher, box: list[int], value: int = 255, **head: Any) -> None:
    """Rows and columns of the first module, from and to."""
    watcher.say("paint", spot(box[1] - box[0], box[3] - box[2], value), module=0, box=box, **head)


def until_lit(watcher: Watcher, expected: np.ndarray) -> None:
    """Wait for a step with these utilisations of the first module."""
    watcher.until(lambda head: "u.0" in head.get("arrays", {}) and np.array_equal(watcher.got[-1][1]["u.0"], expected))


def test_the_place_that_lights_up_is_that_of_the_pixels(served, editor):
    """The brightest texel of the light that arrives, cast onto the road, lies where the pixels' own light is brightest."""
    rows, cols = SIZE
    row, col = int(0.8 * rows), int(0.4 * cols)
    box = [row, row + max(1, rows // 40), col, col + max(1, cols // 40)]
    first, before = editor.of("step")
    published = served.studio.session.state
    light = published.runs[0].simulation.modules[0].headlight
    texture = np.zeros((light.rows, light.cols), np.float32)
    paint(editor, box, over=False)
    head, arrays = editor.until(lambda head: head["type"] == "step" and "0" in head["light_windows"])
    assert served.studio.session.state.number == published.number  # nothing starts anew
    u = np.zeros((rows, cols), np.uint8)
    u[box[0] : box[1], box[2] : box[3]] = 255
    assert np.array_equal(arrays["u.0"], u)
    for told, sent in ((first, before), (head, arrays)):
        top, bottom, left, right = told["light_windows"]["0"]
        texture[top:bottom, left:right] = sent["light.0"]
    T = torch.tensor(head["modules"][0]["T_world_module"], dtype=torch.float64).view(4, 4)
    expected = light.matrix.to_scipy()[:, np.flatnonzero(u)].sum(1).A.reshape(texture.shape)
    there, wanted = (on_road(T, centre(light, each)) for each in (texture, expected))
    assert 3 < wanted[0] < 100
    assert torch.linalg.norm(there - wanted) < 0.02 * wanted[0]  # light is sent as half floats, poses with six digits


def centre(light: object, texture: np.ndarray) -> tuple[float, float]:
    """Tangents to the left and up of the centre of a light texture."""
    grid = {key: float(getattr(light, key)) for key in ("left", "right", "top", "bottom")}
    rows, cols = texture.shape
    row, col = (float((texture.sum(axis) * (np.arange(n) + 0.5)).sum() / texture.sum() / n) for axis, n in ((1, rows), (0, cols)))
    return grid["left"] + col * (grid["right"] - grid["left"]), grid["top"] + row * (grid["bottom"] - grid["top"])


def on_road(T_world_module: torch.Tensor, tangents: tuple[float, float]) -> torch.Tensor:
    origin, tip = transform(T_world_module, torch.tensor([[0.0, 1.0], [0.0, tangents[0]], [0.0, tangents[1]]], dtype=torch.float64)).T
    return origin + (tip - origin) * origin[2] / (origin[2] - tip[2])


def test_boxes_add_up_and_what_is_rubbed_out_is_as_before(served, bare):
    _, cols = SIZE
    bare.reset()
    before = bare.of("step", step=0)[1]["u.0"]
    paint(bare, [0, 1, 0, 5], 100, over=True)
    paint(bare, [1, 3, 2, 4], 7, over=True)
    expected = before.copy()
    expected[0, :5], expected[1:3, 2:4] = 100, 7
    until_lit(bare, expected)
    nothing = {"value": np.full((2, cols), 9, np.uint8), "painted": np.zeros((2, cols), np.uint8)}
    bare.say("paint", nothing, module=0, box=[0, 2, 0, cols], over=True)
    expected[:2] = before[:2]
    until_lit(bare, expected)
    published = served.studio.session.state
    params = published.runs[0].simulation.scenario.lighting.painted[0]
    assert params.module == "left matrix" and np.array_equal(params.pictures[1][2], np.where(np.arange(cols) // 2 == 1, 255, 0))
    (override,) = published.runs[0].tally.edits[-1].overrides
    again = prepare(load("gfhb", [*BARE, f"headlight.model={MODEL}", override]), "cpu")
    bare.step(1)
    assert again.at(1).lights[0].equal(published.runs[0].snapshots[1].lights[0])


def test_strokes_are_taken_back_and_saved(served, bare, tmp_path, monkeypatch):
    monkeypatch.setattr("luxloop.loop.studio.session.TOGETHER_S", 0.0)  # a stroke may rest while it is drawn
    expected = np.zeros(SIZE, np.uint8)
    expected[2, 0:4] = 255
    first = expected.copy()
    expected[0:2, 3:6] = 255
    for stroke, box in ((1, [2, 3, 0, 4]), (2, [0, 1, 3, 6]), (2, [0, 2, 3, 6])):
        paint(bare, box, stroke=stroke, over=False)
    until_lit(bare, expected)
    run = served.run
    bare.say("save")
    (tmp_path / "mine.toml").write_text(bare.of("saved")[0]["text"])
    saved = load(str(tmp_path / "mine.toml"))
    assert saved.lighting.painted == run.simulation.scenario.lighting.painted
    assert np.array_equal(255 * prepare(saved, "cpu").at(0).lights[0], expected.ravel())
    for way, light in (("undo", first), ("redo", expected)):
        bare.say(way)
        until_lit(bare, light)


def test_the_flux_noted_at_rest_is_that_of_the_paint(served, bare):
    rows, cols = SIZE
    paint(bare, [0, rows, 0, cols], 0, over=False)
    head, _ = bare.until(lambda head: head["type"] == "step" and any(each.startswith("left 0 lm, right ") for each in head["notes"]))
    assert not any("right 0 lm" in each for each in head["notes"])  # the other module keeps its beam


def test_what_does_not_fit_changes_nothing(served, editor):
    before = served.scenario
    for module, box, words in (
        *((9, [0, 1, 0, 5], "no module 9"), (0, [0, 4, 0, 99999], "not within")),
        *((0, [1, 1, 0, 5], "not within"), (0, [0, 2, 0, 4], "2 x 4 pixels")),
    ):
        editor.say("paint", spot(1, 5), module=module, box=box, over=True)
        assert words in editor.of("error", about="paint")[0]["text"]
    assert served.scenario == before


def lit(served: Served, point: list[float], module: int = 0) -> float:
    """Illuminance in lx, of what faces the lamp, at a point of the world by the light that a module shows last."""
    run = served.run
    shown, light = run.snapshots[-1], run.simulation.modules[module].headlight
    T = torch.tensor(shown.head["modules"][module]["T_world_module"], dtype=torch.float64).view(4, 4)
    there = torch.tensor(point, dtype=torch.float64)[:, None]
    intensity = light.intensity(light.light_texture(shown.lights[module]), transform(inverse(T), there).float())
    return float(intensity) / float((there - T[:3, 3:]).square().sum())


def test_a_place_of_the_world_is_lit_by_the_pixels_that_are_named(served, bare):
    point = [25.0, 1.0, 0.0]
    bare.say("place", point_m=point)
    head, _ = bare.of("place")
    assert [each["module"] for each in head["modules"]] == [0, 1] and head["point_m"] == point
    assert not served.scenario.lighting.painted
    for value, share in ((0, 0.5), (255, 1.0)):  # the pixels that are not named give less than half of the light
        bare.say("place", point_m=point, value=value)
        head, _ = bare.of("place")
        most = head["modules"][0]["cd"] / (25**2 + 0.4**2 + 0.75**2)
        assert value / 255 * 0.99 * most <= lit(served, point) <= share * 2 * most
    bare.say("place", point_m=[-40.0, 0.0, 0.0], value=255)
    assert bare.of("place")[0]["modules"] == []


def test_light_wanted_on_the_wall_is_painted(served, bare):
    raster = {"lx": np.zeros((70, 240), np.float32), "painted": np.zeros((70, 240), np.uint8)}
    raster["lx"][30:40, 115:125] = 2  # half a metre above and below the ground, and to both sides
    raster["painted"][30:40, 115:125] = 1
    bare.say("wish", raster, on="wall", box_m=[-3.5, 3.5, -12, 12])
    head, _ = bare.of("wish")
    assert head["on"] == "wall" and head["wanted_lx"] == 2 and head["pixels"] > 0
    points = np.random.default_rng(0).uniform(-0.45, 0.45, (200, 2))
    there = np.mean([sum(lit(served, [25.0, *point], module) for module in (0, 1)) for point in points])
    assert abs(there - 2) <= 0.5  # 200 points of a pattern of dark and lit pixels, facing a lamp and not the car
    assert abs(head["given_lx"] - 2) < 0.3  # a step of 1 in 255 is 0.6 lx there, of each lamp
    assert 0 < head["rmse_lx"] < 1  # of the whole field, whose light spreads over the border of what is wanted
    bare.say("wish", raster, on="ceiling", box_m=[-3.5, 3.5, -12, 12])
    assert "'road' or 'wall'" in bare.of("error")[0]["text"]


def test_light_wanted_on_the_road_is_painted_on_all_modules_together(served, bare):
    raster = {"lx": np.zeros((60, 20), np.float32), "painted": np.zeros((60, 20), np.uint8)}
    raster["lx"][24:36, 7:13] = raster["painted"][24:36, 7:13] = 1
    bare.say("wish", raster, box_m=[0, 60, -10, 10])
    head, _ = bare.of("wish")
    assert head["wanted_lx"] == 1 and 0 <= head["rmse_lx"] <= head["worst_lx"]
    assert head["worst_lx"] < 0.2
    painted = served.scenario.lighting.painted
    assert [each.module for each in painted] == ["left matrix", "right matrix"]
    assert sum(int((each.pictures[1] > 0).sum()) for each in painted) == head["pixels"]
    for arrays, box, told in (
        ({"lx": np.zeros((2, 3), np.float32), "painted": np.ones((3, 2), np.uint8)}, [0, 60, -10, 10], "shapes"),
        ({"lx": np.zeros((300, 300), np.float32), "painted": np.ones((300, 300), np.uint8)}, [0, 60, -10, 10], "20000 cells"),
        (raster | {"painted": np.zeros((60, 20), np.uint8)}, [0, 60, -10, 10], "nothing is painted"),
        (raster | {"lx": np.full((60, 20), np.nan, np.float32)}, [0, 60, -10, 10], "between 0 and"),
        (raster, [60, 0, -10, 10], "empty"),
        (raster, [-60, -10, -10, 10], "no pixel lights"),
    ):
        bare.say("wish", arrays, box_m=box)
        assert told in bare.of("error", about="wish")[0]["text"]


@pytest.fixture(scope="module")
def masked(page_folder: Path) -> Iterator[Served]:
    """Masks and soft zones around four road users."""
    small = ("renderer=raycast", "camera.width_px=640", "camera.height_px=266", "camera.oversampling=1", "checks={}")
    yield from serving(Source("gfhb", small), page_folder)


def test_masks_win_over_light_that_is_wanted_and_the_field_beside_it_stays(masked):
    """1 lx wanted over the whole road by the cyclist, the pole and the car ahead."""
    spots = {(30, 3): 0.7, (20, 4): 0.7, (28, -3): 0.1}  # with the least light in lx: a mask holds most of the pixels of the last one
    x, y = np.meshgrid((np.arange(120) + 0.5) / 2, (np.arange(40) + 0.5) / 2 - 10, indexing="ij")
    there = np.min([np.hypot(x - at[0], y - at[1]) for at in spots], 0) < 2
    with watching(masked.port, masked.tokens.edit) as editor:
        editor.say("pen")
        editor.of("step")
        run = masked.run
        lit, first = run.simulation.world.lit(0.0), run.snapshots[-1]
        editor.say("wish", {"lx": there.astype(np.float32), "painted": there.astype(np.uint8)}, box_m=[0, 60, -10, 10])
        head, _ = editor.of("wish")
    before, after = (lit.light(list(each.lights))[0] for each in (first, run.snapshots[-1]))
    surface = {name: lit.surfaces.object_id == k - 1 for k, name in enumerate(run.simulation.world.instances)}
    for name in ("oncoming_car", "car_ahead", "cyclist", "pole"):
        assert surface[name].any() and before[surface[name]].max() < 0.01 and (after <= before)[surface[name]].all()
    away = torch.stack([(lit.surfaces.position[:2] - torch.tensor(at).view(2, 1, 1)).norm(dim=0) - 2 for at in spots])
    change = (after - before)[surface["road"] & (away.amin(0) > 4)].abs()
    assert change.max() < 0.15  # docs/studio.md; closer, the pixels and their spread reach over the border of what is wanted
    given = [float(after[surface["road"] & (each < 0)].mean()) for each in away]
    assert all(lx > least for lx, least in zip(given, spots.values(), strict=True))
    assert head["given_lx"] == pytest.approx(np.mean(given), abs=0.1)  # the camera has more pixels of the near end
    assert head["worst_lx"] > 0.5 and 0 < head["rmse_lx"] < 0.2  # of the whole field: the masked road remains dark


def test_masks_win_in_every_step_as_road_users_move(masked):
    """5 lx wanted over a wall that covers all road users: in step 19 the cyclist is gone, and the others are elsewhere."""
    everywhere = {"lx": np.full((70, 240), 5, np.float32), "painted": np.ones((70, 240), np.uint8)}
    h, v = torch.tensor([[6.5], [2.3]], dtype=torch.float64)  # towards the cyclist in step 0

    def towards_cyclist() -> float:
        shown = masked.run.snapshots[-1]
        T_world_body = torch.tensor(shown.head["T_world_body"], dtype=torch.float64).view(4, 4)
        return float(wall_illuminance([*masked.run.sources(shown).values()], T_world_body, h, v))

    with watching(masked.port, masked.tokens.edit) as editor:
        editor.say("pen")
        editor.of("scenario")
        editor.reset()
        editor.of("step", step=0)
        editor.say("wish", everywhere, on="wall", box_m=[-3.5, 3.5, -12, 12])
        editor.of("wish")
        first = towards_cyclist()
        for step in range(1, 20):
            editor.step(step)
            assert masked.run.shown[1].dark_lx_max <= 0.01, step  # as the scenario demands without paint
        assert first < 0.5 and abs(towards_cyclist() - 5) < 2  # the spread of its pixels
