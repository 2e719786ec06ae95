"""Light that clients measure under a cursor: what `world`, probes and a beam's check say of the same place."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.report.measure import towards
from luxloop.loop.scenario.probes import ProbeParams
from luxloop.loop.simulation.light_figures import illuminance_at
from luxloop.loop.studio.runs import matrix
from luxloop.loop.studio.sources import Source
from luxloop.world.frames import inverse, transform
from luxloop.world.headlight.lamp import direction
from luxloop.world.lamps.description import load_lamp
from luxloop.world.light.emitters import wall_illuminance
from tests.loop.studio.clients import Watcher, watching
from tests.loop.studio.conftest import SMALL, Served, serving

EDGES = 1e-4  # relative: a texel's place in float32, times the steepest change of light from texel to texel
SINGLE = 1e-5  # relative, of sums in float32 whose terms are added in another order


@pytest.fixture(scope="module")
def served(page_folder) -> Iterator[Served]:
    """A car with two worn lamps among road users and a street lamp."""
    lamp = "light.street_lamps=[{position_m=[20.0, 4.0, 6.0], intensity_cd=900.0}]"
    yield from serving(Source("gfhb", (*SMALL, lamp, "disturbances.wear.dead=0.2")), page_folder)


@pytest.fixture
def watcher(served: Served) -> Iterator[Watcher]:
    with watching(served.port, served.tokens.watch) as watcher:
        watcher.of("step", step=0)
        yield watcher


def measured(watcher: Watcher, eye_m: Sequence[float], through_m: Sequence[Sequence[float]], **how: Any) -> list[Any]:
    watcher.say("meter", eye_m=eye_m, through_m=through_m, **how)
    return list(watcher.of("meter")[0]["readings"])


def pixels(served: Served) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns `[120]` of the camera's pixels, half of them on objects."""
    ids, rng = served.run.simulation.world.lit(0.0).surfaces.object_id.numpy(), np.random.default_rng(0)
    v, u = np.concatenate([rng.permutation(np.argwhere(on))[:60] for on in (ids == 0, ids > 0)]).T
    return v, u


def seen_by_camera(served: Served, watcher: Watcher) -> list[Any]:
    view, (v, u) = served.run.simulation.world.view_at(0.0), pixels(served)
    return measured(watcher, view.origin.tolist(), (view.origin[:, None] + view.rays()[:, v, u]).T.tolist())


def column(readings: Sequence[Any], key: str) -> np.ndarray:
    return np.array([each[key] for each in readings])


def test_light_on_surfaces_is_that_of_the_simulation_at_the_pixels_centre(served, watcher):
    readings, world = seen_by_camera(served, watcher), served.run.simulation.world
    scene, u = world.lit(0.0), [each.clone() for each in served.run.snapshots[0].lights]
    lx, cd_m2 = scene.light(u)
    at = pixels(served)
    assert [each["surface"] for each in readings] == [world.instances[k + 1] for k in scene.surfaces.object_id[at].tolist()]
    assert column(readings, "point_m") == pytest.approx(scene.surfaces.position[:, *at].T.numpy(), abs=1e-4)
    assert column(readings, "lx").max() > 1 and column(readings, "lx") == pytest.approx(lx[at].numpy(), rel=SINGLE)
    assert column(readings, "cd_m2") == pytest.approx((cd_m2 + scene.base)[at].numpy(), rel=SINGLE)


def test_light_on_an_upright_plane_is_that_of_a_probe(served, watcher):
    readings, run = seen_by_camera(served, watcher), served.run
    lights = [Utilisation(u, None) for u in run.snapshots[0].lights]
    T_body_world = inverse(matrix(run.snapshots[0].head["T_world_body"]))
    points = transform(T_body_world, torch.tensor(column(readings, "point_m")).T).T.tolist()
    probes = {str(k): ProbeParams(position_m=tuple(point), frame="car", facing=(-1, 0, 0)) for k, point in enumerate(points)}
    expected = illuminance_at(probes, run.simulation.world, 0.0, lights)
    on_road = [k for k, each in enumerate(readings) if each["surface"] == "road"]  # a probe on the car looks through no other object
    assert column(readings, "vertical_lx")[on_road].max() > 1
    assert column(readings, "vertical_lx")[on_road] == pytest.approx([expected[str(k)] for k in on_road], rel=EDGES)


@pytest.mark.parametrize("side", [None, "left"])
def test_angles_and_intensities_are_those_of_photometry(served, watcher, side):
    h, v = torch.tensor([-8.0, 0.0, 2.5, 6.0]), torch.tensor([-1.0, 0.3, -0.57, 1.2])
    run, T_world_body = served.run, matrix(served.run.snapshots[0].head["T_world_body"])
    shining = [(module.side, source) for module, source in zip(run.simulation.modules, run.sources(run.snapshots[0]).values(), strict=True)]
    chosen = [source for each, source in shining if side in (None, each)]
    origin = torch.stack([source.T_world_source[:3, 3] for source in chosen]).mean(0)
    T_world_lamp = torch.cat([T_world_body[:, :3], torch.cat([origin, torch.ones(1).double()])[:, None]], 1)
    points = transform(T_world_lamp, 25 * direction(h, v))
    readings = measured(watcher, origin.tolist(), points.T.tolist(), on="wall", side=side)
    assert {each["surface"] for each in readings} == {"wall"}
    # what comes back lies on the wall 25 m ahead of the body's origin, which is that of the lamps
    assert column(readings, "h_deg") == pytest.approx(h.numpy(), abs=1e-6) and column(readings, "v_deg") == pytest.approx(
        v.numpy(), abs=1e-6
    )
    assert column(readings, "point_m")[:, 0] == pytest.approx(25)
    lx = wall_illuminance([source for _, source in shining], T_world_lamp, h, v, 25.0 - float(origin[0]))
    assert float(lx.max()) > 1 and column(readings, "lx") == pytest.approx(lx.numpy(), rel=SINGLE)
    ray = T_world_body[:3, :3] @ direction(h, v)
    cd = sum(each.headlight.intensity(each.texture.double(), each.T_world_source[:3, :3].T @ ray) for each in chosen)
    assert column(readings, "cd") == pytest.approx(cd.numpy(), rel=SINGLE)


def test_light_on_the_wall_is_that_of_the_command_measure_whose_angles_start_at_the_mount(page_folder):
    values = ("headlight.model=ssl-hd", "headlight.lamps=['left']", "lighting.base.beam=full", "functions={}", "checks={}")
    for served in serving(Source("gfhb", (*SMALL, *values)), page_folder):
        with watching(served.port, served.tokens.watch) as watcher:
            head, _ = watcher.of("step", step=0)
            lamp, T_world_body = load_lamp("ssl-hd", "left"), matrix(head["T_world_body"])
            centres = torch.stack([each.T_lamp_module[:3, 3] for each in lamp.modules])
            assert centres.norm(dim=1).max() > 0.02  # m, of modules beside the mount
            h_v = torch.tensor([[-8.0, 0.0, 2.5, 6.0], [-1.0, 0.3, -0.57, 1.2]], dtype=torch.float64)
            expected = towards(replace(lamp, beams={"shown": served.run.snapshots[0].lights}), "shown", h_v)
            origin = transform(T_world_body, torch.tensor([[0.0], [0.6], [0.75]], dtype=torch.float64))
            through = origin + T_world_body[:3, :3] @ direction(*h_v)
            readings = measured(watcher, origin[:, 0].tolist(), through.T.tolist(), on="wall", side="left")
            for key in ("h_deg", "v_deg"):
                assert column(readings, key) == pytest.approx(expected[key].numpy(), abs=1e-4)  # poses have six digits
            for key in ("cd", "lx"):
                assert expected[key].max() > 1 and column(readings, key) == pytest.approx(expected[key].numpy(), rel=1e-3)  # of 1e-4 deg


def test_a_ray_into_the_sky_has_no_reading_and_a_step_without_light_says_so(served, watcher, monkeypatch):
    assert measured(watcher, [0, 0, 1.2], [[1, 0, 2.0], [10, 0, 0]])[0] is None
    snapshot = served.run.snapshots[0]
    monkeypatch.setattr(served.run, "snapshots", [replace(snapshot, lights=(), pictures={})])
    watcher.say("meter", eye_m=[0, 0, 1.2], through_m=[[10, 0, 0]])
    assert "no longer kept" in watcher.of("error", about="meter")[0]["text"]


def test_a_wall_behind_the_eye_is_not_seen(served, watcher):
    ahead, behind = measured(watcher, [30, 0, 1.2], [[10, 0, 1.2], [40, 0, 1.2]], on="wall")
    assert ahead["point_m"] == pytest.approx([25, 0, 1.2]) and behind is None


def test_a_side_without_a_lamp_is_refused_in_a_sentence(page_folder):
    for served in serving(Source("gfhb", (*SMALL, "headlight.lamps=['left']")), page_folder):
        with watching(served.port, served.tokens.watch) as watcher:
            watcher.of("scenario")
            watcher.say("meter", eye_m=[0, 0, 1.2], through_m=[[10, 0, 0]], side="right")
            assert "has no right lamp" in watcher.of("error", about="meter")[0]["text"]
