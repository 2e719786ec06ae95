"""The recording plant: old frames with the light that they show, on which another controller steps in shadow."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from luxloop import Exposure, Scenario, Simulation, load, prepare, run, validate
from luxloop.loop.recording.manifest import table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.simulation.columns import SYMBOL, of_one, symbol_columns
from luxloop.loop.simulation.frames import TABLE, image_file, light_file
from luxloop.perception.appearance import DEGREES
from tests.loop.conftest import SMALL, assert_refused, box, toml
from tests.refusal import refusal


def held_by(controller: str) -> dict[str, Any]:
    return {"symbol": SMALL["functions"]["symbol"] | {"controller": {"name": controller}}}


LATE = {"camera": SMALL["camera"] | {"latency_spread_steps": 2, "drop_probability": 0.2}}
STANDS = SMALL | {"steps": 6} | LATE
DRIVES = (
    SMALL
    | toml("""
steps = 5
vehicle.course = [{ speed_m_s = 10.0 }]
road.kind = "bumps"
sensors = { attitude = { noise_deg = 0.01, delay_s = 0.03 }, gyro.rate_hz = 100 }
""")
    | {"functions": held_by("luxloop")}
)
TWO = (
    SMALL
    | toml("""
steps = 4
road = { kind = "bumps", seed = 3 }
[functions]
flake = { kind = "symbol", image = "snowflake", x_m = 17.5, y_m = 1.4, controller = "thesis_pid", start.x_m = 15.0 }
way = { kind = "symbol", image = "chevrons", x_m = 16.0, y_m = -1.4, controller = "luxloop", start.x_m = 17.0 }
guard.kind = "glare_free"
""")
    | {"objects": [box("motorcycle", (2.1, 0.8, 1.3), (15.4, 1.1, 0.0), category="motorcycle")]}
)
ASKED = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg")
OTHER = "holds the light of other modules than those that draw here; run it with the scenario recorded"
RECORDED = {"stands": STANDS, "drives": DRIVES, "two": TWO}
SEEN = ("e_x", "e_y", "pose_error_x_m", "c_u", "c_v", "area_ratio", "loss")


def scenario_of(data: dict[str, Any], **changes: Any) -> Scenario:
    return validate({**data, **changes}, "recorded")


def playing(data: dict[str, Any], folder: Path, **changes: Any) -> Simulation:
    return prepare(scenario_of(data, plant={"kind": "recording", "folder": str(folder)}, **changes), "cpu")


def recorded_in(folder: Path, name: str = "symbol") -> pa.Table:
    """Of a symbol, under the short names of its columns."""
    return of_one(pq.read_table(folder / "trajectory.parquet"), name)


def run_of(simulation: Simulation) -> pa.Table:
    """A row a step, as a recording has them."""
    return table_of([row(result) for result in simulation.evaluations()], schema(simulation))


def asked_and_seen(simulation: Simulation) -> pa.Table:
    """The same of its symbol, under the short names of its columns."""
    return of_one(run_of(simulation), "symbol")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Recordings of a car that stands, of one that drives, and of two symbols beside a mask."""
    folder = tmp_path_factory.mktemp("recorded")
    for name, data in RECORDED.items():
        run(scenario_of(data), folder / name, frames=True, video=False, report=False, device="cpu")
    return {name: folder / name for name in RECORDED}


@pytest.mark.parametrize(("name", "data"), [("stands", STANDS), ("drives", DRIVES)])
def test_the_controller_that_was_recorded_asks_for_the_same_again(name, data, recorded):
    table, simulation = recorded_in(recorded[name]), playing(data, recorded[name])
    again = asked_and_seen(simulation)
    for each in (*ASKED, *SEEN, "time_s"):
        assert again[each].to_pylist() == table[each].to_pylist(), f"{each}, bit for bit"
    assert simulation.symbol.evaluator is None and again["iou"].null_count == len(again)
    assert None in table["e_x"].to_pylist() or name == "drives", "some frames are lost"


def test_another_controller_asks_for_its_own_and_sees_what_was_shown(recorded):
    """What it sees is that of the recording, however far from it is what it asks for."""
    table = recorded_in(recorded["stands"])
    again = asked_and_seen(playing(STANDS, recorded["stands"], functions=held_by("open")))
    assert again["x_m"].to_pylist() == [17.0] * 6 and table["x_m"].to_pylist() != [17.0] * 6
    other = asked_and_seen(playing(STANDS, recorded["stands"], functions=held_by("gauss_newton")))
    for each in SEEN:
        assert again[each].to_pylist() == other[each].to_pylist() == table[each].to_pylist()
    assert other["x_m"][-1].as_py() != table["x_m"][-1].as_py() != 17.0


def test_symbols_that_lie_side_by_side_and_below_a_mask_are_played(recorded):
    """The recorded light has the mask in it, so that the object that it covers need not be known. Each symbol has its own controller."""
    again = run_of(playing(TWO, recorded["two"], objects=[]))
    flake = TWO["functions"]["flake"] | {"controller": "gauss_newton"}
    other = run_of(playing(TWO, recorded["two"], objects=[], functions=TWO["functions"] | {"flake": flake}))
    for name in ("flake", "way"):
        table = recorded_in(recorded["two"], name)
        assert 0 < table["e_x"].null_count < 4, "they lie in one another's way, so that each is measured in its turn"
        for each in (*ASKED, *SEEN):
            assert of_one(again, name)[each].to_pylist() == table[each].to_pylist(), f"{name}, {each}, bit for bit"
        for each in SEEN if name == "flake" else (*ASKED, *SEEN):
            assert of_one(other, name)[each].to_pylist() == table[each].to_pylist(), f"{name}, {each}, bit for bit"
    assert of_one(other, "flake")["x_m"][-1].as_py() != recorded_in(recorded["two"], "flake")["x_m"][-1].as_py()
    unknown = playing(TWO, recorded["two"])
    assert not unknown.situation(0.0).objects and run_of(unknown)["functions.flake.x_m"].equals(again["functions.flake.x_m"])
    unlike = {"symbol": SMALL["functions"]["symbol"]}
    with refusal(r"shows none of the symbols that are held here, symbol, but (flake|way)"):
        playing(TWO, recorded["two"], objects=[], functions=unlike)


def test_an_old_state_shows_the_same_frames_again(recorded):
    simulation = playing(DRIVES, recorded["drives"])
    plant, exposure = simulation.plant, Exposure(0, 0.0, 0.1, simulation.symbol.projector.resting)
    state, first = plant.start()
    states = [(state, first)]
    for _ in range(4):
        states.append(plant.show(states[-1][0], exposure))
    (frame,), (again,) = states[3][1].frames, plant.show(states[2][0], exposure)[1].frames
    assert frame.number == again.number == 2 and frame.image is not None and again.image is not None and frame.image.equal(again.image)
    assert frame.shown is not None and set(frame.shown.projections) == {"symbol"}
    off = states[4][1].frames[0].shown
    assert off is not None and off.projections == {}


def test_a_shadow_is_recorded_beside_and_says_what_it_is(lux, tmp_path):
    assert lux("run", "small.toml", "--out", "drive", "--frames", "--no-video", "--no-report")[0] == 0
    before = {file.name: file.read_bytes() for file in (tmp_path / "drive").rglob("*") if file.is_file()}
    code, out, _ = lux("run", "small.toml", "--plant", "drive", "--controller", "thesis_pid", "--out", "shadow")
    words = f"in shadow on the frames of {tmp_path / 'drive'}; the commands of this run were not shown and not evaluated"
    assert code == 0 and "".join(words.split()) in "".join(out.split())
    assert (tmp_path / "shadow/report.png").exists() and (tmp_path / "shadow/video.mp4").exists()
    assert {file.name: file.read_bytes() for file in (tmp_path / "drive").rglob("*") if file.is_file()} == before
    drive, shadow = (recorded_in(tmp_path / name) for name in ("drive", "shadow"))
    assert drive["x_m"].to_pylist() != shadow["x_m"].to_pylist() and shadow["iou"].null_count == 3
    assert lux("replay", "shadow")[0] == 0
    again = ("run", "small.toml", "--plant")
    assert_refused(lux(*again, "drive", "--out", "drive"), "drive: is the recording that is played, which this run would replace")
    assert_refused(lux(*again, "drive", "--steps", "4", "--out", "other"), "steps=4 plant=drive: plant.folder: ", "holds 3 steps")
    code, out, _ = lux(*again, "drive", "--set", "steps=9", "--out", "other", "--no-video", "--no-report")
    assert code == 0 and pq.read_table(tmp_path / "other/trajectory.parquet").num_rows == 3, "it ends with the recording"
    assert_refused(lux(*again, "drives", "--out", "none"), "drives does not exist")
    assert_refused(lux(*again, "shadow", "--out", "other"), "shadow holds no frames; record frames with `luxloop run --frames`")


def test_a_recording_plays_its_own_frames(lux, tmp_path):
    """With the scenario in it, so that a plant that is gone need not be named."""
    assert lux("run", "small.toml", "--out", "runs/drive", "--frames", "--no-video", "--no-report")[0] == 0
    manifest = tmp_path / "runs/drive/manifest.json"
    manifest.write_text(manifest.read_text().replace('"kind": "simulated"', '"kind": "gone:Rig", "options": {}'))
    code, out, error = lux("run", "runs/drive", "--plant", "recording", "--out", "again", "--no-video", "--no-report")
    assert code == 0 and "light that of the recording, in all 6 exposures with a frame" in " ".join(out.split()), error
    drive, again = (recorded_in(tmp_path / name) for name in ("runs/drive", "again"))
    assert again["x_m"].to_pylist() == drive["x_m"].to_pylist()
    options = ("--plant", "recording", "--controller", "open", "--set", "functions.symbol.x_m=19.0", "--no-video", "--no-report")
    code, out, _ = lux("run", "runs/drive", *options, "--out", "other")
    assert code == 0 and "light other than in the recording in 3 of 6 exposures with a frame, by " in " ".join(out.split())
    told = json.loads((tmp_path / "other/summary.json").read_text())["shadow"]
    assert (told["exposures"], told["differ"]) == (6, 3) and 0.2 < told["elsewhere"] <= 0.5, "off frames have no light of either"
    assert_refused(lux("run", "runs/drive", "--plant", "recording"), "runs/drive: is the recording that is played")
    assert_refused(lux("run", "small.toml", "--plant", "recording"), "recording does not exist")


def linked(folder: Path) -> None:
    image_file(folder, 2).unlink()
    image_file(folder, 2).symlink_to(folder / "manifest.json")


def of_another_size(folder: Path) -> None:
    cv2.imwrite(str(image_file(folder, 2)), np.zeros((90, 160), np.uint16))


def of_another_lamp(folder: Path) -> None:
    np.savez(light_file(folder, 2), u_0=np.zeros(3, np.float32))


def of_nothing(folder: Path) -> None:
    np.savez(light_file(folder, 2), u_0=np.full(332 * 64, np.nan, np.float32))


def in_table(change: Callable[[pa.Table], pa.Table]) -> Callable[[Path], None]:
    return lambda folder: pq.write_table(change(pq.read_table(folder / TABLE)), folder / TABLE)


def without(name: str, number: int, value: str | None = None) -> Callable[[pa.Table], pa.Table]:
    """A value is missing in an exposure, or is a wrong one."""

    def change(table: pa.Table) -> pa.Table:
        column = table.column_names.index(name)
        values = table[name].to_pylist()
        values[number] = value
        return table.set_column(column, table.schema.field(name), pa.array(values, table.schema.field(name).type))

    return change


DAMAGE: dict[str, Callable[[Path], Any]] = {
    r"frame_00000002.png: is a link, but a recording holds its own files": linked,
    "has 160 x 90 px, but the camera 320 x 180": of_another_size,
    r"frame_00000002.png: cannot be read \(No such file": lambda folder: image_file(folder, 2).unlink(),
    OTHER: of_another_lamp,
    "u_0 is no finite float": of_nothing,
    "holds no frames": lambda folder: (folder / TABLE).unlink(),
    "no exposures that are numbered from 0": in_table(lambda table: table.slice(0, 1)),
    "exposures.parquet: damaged, or no table of exposures .*came_with": in_table(lambda table: table.drop(["came_with"])),
    "exposure 3 is not complete": in_table(without("light", 3)),
    "a sample of gyro has no such values": in_table(without("samples", 1, '[["gyro", 0, 0, [1, 2]]]')),
}


@pytest.mark.parametrize("words", DAMAGE)
def test_what_is_damaged_or_lies_elsewhere_is_refused_in_a_sentence(words, recorded, tmp_path):
    folder = shutil.copytree(recorded["drives"], tmp_path / "copy")
    DAMAGE[words](folder)
    with refusal(words) as caught:
        list(playing(DRIVES, folder).evaluations())
    assert str(folder) in str(caught.value) and "\n" not in str(caught.value)


def test_frames_of_lighting_functions_hold_no_symbol(tmp_path):
    for lamps, words in (("['left', 'right']", OTHER), ("['left']", "shows none of the symbols that are held here, symbol, but none")):
        given = ["camera={ width_px=320, height_px=180, oversampling=1 }", "renderer=raycast", f"headlight.lamps={lamps}"]
        run("gfhb", tmp_path / "gfhb", frames=True, video=False, report=False, overrides=given, steps=2)
        model = load("gfhb", given).headlight.model
        with refusal(words):
            playing({**SMALL, "steps": 1, "headlight": {"model": model, "lamps": ["left"]}}, tmp_path / "gfhb")


def test_a_fifth_degree_of_freedom_has_columns():
    yaw = replace(DEGREES[2], name="yaw", shown="shown pose: rotation about the upward axis")
    columns = symbol_columns((*DEGREES, yaw))
    assert list(symbol_columns(DEGREES)) == [each for each in columns if "yaw" not in each] and len(columns) == len(SYMBOL) + 3
    assert columns["yaw_deg"] == ("deg", "shown pose: rotation about the upward axis") and {"e_yaw", "pose_error_yaw_deg"} <= set(columns)
