"""The kinds of files that luxloop reads: sound ones, how they are damaged, and what reads them."""

import functools
import json
import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand, Warp
from luxloop.loop.recording import replay
from luxloop.loop.recording.manifest import Manifest
from luxloop.loop.rig.calibration import calibrate as calibrations
from luxloop.loop.rig.calibration.geometry import CameraModel, Pose
from luxloop.loop.rig.calibration.shots import linear_response
from luxloop.loop.rig.params import load_rig
from luxloop.loop.rig.rectification import load_lens
from luxloop.loop.rig.simulated import faults
from luxloop.loop.rig.simulated.lens import Lens
from luxloop.loop.run import check
from luxloop.loop.scenario.model import load, validate
from luxloop.loop.scenario.shipped import examples, scenario_files
from luxloop.loop.simulation import frames
from luxloop.loop.simulation.protocol import Exposure
from luxloop.loop.studies import campaign
from luxloop.loop.studies.jobs import run as run_jobs
from luxloop.loop.studies.training import dataset
from luxloop.perception.camera import CameraParams
from luxloop.perception.detection import network
from luxloop.perception.egomotion import Sample
from luxloop.world.arrays import read_parquet, write_npz
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Lamp, Module, ModuleCommand
from luxloop.world.headlight.sources import TableSource
from luxloop.world.lamps import archive, description
from luxloop.world.lamps.utilisations import read_utilisation
from luxloop.world.opencrg import Crg
from luxloop.world.photometry import lm63, read_photometry
from luxloop.world.photometry.distribution import Distribution
from luxloop.world.roads.scan import OpenCrgRoad
from luxloop.world.spmv import Csr
from luxloop.world.symbols import load_still, video
from luxloop.world.traffic.objects import MeshParams
from luxloop.world.traffic.tracked import KeyframeParams
from tests.fuzz import messages, mutations
from tests.world.opencrg.writer import write_crg
from tests.world.traffic.test_mesh_files import RIGHT

SMALL = ["camera.width_px=160", "camera.height_px=90", "camera.oversampling=1", "renderer=raycast", "steps=2"]
RECORDING = Path(__file__).parents[2] / "scenarios" / "recordings" / "flat.parquet"
Damage = Callable[[bytes, random.Random], bytes]


@dataclass(frozen=True)
class Kind:
    """sound: bytes of files by name, made once in a folder. damage: of such bytes. read: what luxloop does with a file.

    share: how often it is tried beside others.
    """

    sound: Callable[[Path], dict[str, bytes]]
    damage: Damage
    read: Callable[[Path], Any]
    share: int = 4


def _text(data: bytes, rng: random.Random) -> bytes:
    return mutations.of_text(data.decode("latin-1"), rng).encode("utf-8", "replace")


def _either(data: bytes, rng: random.Random) -> bytes:
    return rng.choice((_text, mutations.of_bytes))(data, rng)


def _archive_or(other: Damage) -> Damage:
    return lambda data, rng: (mutations.of_archive if data.startswith(b"PK") else other)(data, rng)


def _nested(data: bytes, rng: random.Random) -> bytes:
    return json.dumps(mutations.of_tables(json.loads(data), rng)).encode()


def _json(data: bytes, rng: random.Random) -> bytes:
    return (_text if rng.random() < 0.3 else _nested)(data, rng)


def _written(folder: Path, *writers: tuple[str, Callable[[Path], Any]]) -> dict[str, bytes]:
    for name, write in writers:
        write(folder / name)
    return {name: (folder / name).read_bytes() for name, _ in writers}


@functools.cache
def scenarios() -> dict[str, Path]:
    """Those shipped that need no data of others."""
    return {name: path for name, path in scenario_files().items() if 'kind = "opencrg"' not in path.read_text("utf-8")}


def _scenarios(folder: Path) -> dict[str, bytes]:
    return {f"{name}.toml": path.read_bytes() for name, path in scenarios().items()}


@functools.cache
def _plain(name: str) -> dict[str, Any]:
    return load(name).model_dump(mode="json")


def _resolved(folder: Path) -> dict[str, bytes]:
    return {f"{name}.json": json.dumps(_plain(name)).encode() for name in scenarios()}


def _example(name: str) -> Callable[[Path], dict[str, bytes]]:
    return lambda folder: {name: examples()[name].read_bytes()}


def _manifests(folder: Path) -> dict[str, bytes]:
    manifest = Manifest.of(load("flat"), "raycast", torch.device("cpu")).model_dump(mode="json")
    return {"manifest.json": json.dumps(manifest).encode()}


def _read_manifest(path: Path) -> None:
    path.rename(path.with_name("manifest.json"))
    validate(Manifest.read(path.parent).scenario, str(path))


def _overridden(path: Path) -> None:
    """Build it, small, with one key of a recorded scenario changed."""
    check(load(path.stem, [*SMALL, path.read_text()]))


def _overrides(folder: Path) -> dict[str, bytes]:
    return {f"{name}.txt": json.dumps(_plain(name)).encode() for name in ("flat", "snowflake", "obl", "gfhb", "zones")}


def _override(data: bytes, rng: random.Random) -> bytes:
    """`key=value` of a key that is there."""
    key, value = "", json.loads(data)
    while isinstance(value, dict | list) and value:
        step, value = rng.choice(list(value.items() if isinstance(value, dict) else enumerate(value)))
        key += f"[{step}]" if isinstance(step, int) else f".{step}" if key else step
    return f"{key}={rng.choice(rng.choice((mutations.NUMBERS, EDGES)))}".encode()


EDGES = ("0.01", "0.5", "2", "3", "60", "1000", "10000", "1e-9", "1e6", "-10000", "-0.5")
DATASET = b"""
labels = "coco"
masks = true
steps = 2
vary = ["light.ambient_lx=0.01:0.3:log"]
[set]
camera = { width_px = 160, height_px = 80 }
[variants.low]
lighting.base.beam = "low"
"""
CAMPAIGN = b"""
scenarios = ["flat", "snowflake"]
controllers = ["thesis_pid", "luxloop"]
seeds = [0, 1]
[set]
steps = 3
camera.width_px = 320
[variants.dim]
headlight.intensity_cd = 1000.0
[[runs]]
scenario = "curb"
controller = "luxloop"
variant = "dim"
seed = 4
"""
LAMP = b"""
name = "small"
notes = "made up"
[[module]]
name = "matrix"
mount = { x_m = 0.1, yaw_deg = 3 }
swivel_deg = [-10, 10]
[module.source]
kind = "blurred_rectangles"
rows = 2
columns = 4
left_deg = 8
right_deg = -8
bottom_deg = -3
top_deg = 3
blur_deg = 0.3
peak_cd = 1000
[module.texture]
rows = 24
columns = 40
left_deg = 9
right_deg = -9
bottom_deg = -4
top_deg = 4
[module.overlap]
keep = 3
bound_cd = 0.5
[[module]]
name = "glow"
cutoff = 0.01
[module.source]
kind = "gaussian"
columns = 3
left_deg = 8
right_deg = -8
row_centres_deg = [1, -1]
row_sigmas_deg = [1, 2]
column_sigma = 0.5
peak_cd = [10, 20]
"""


def _lamp_files(folder: Path) -> dict[str, bytes]:
    generator = np.random.default_rng(0)
    matrix = Csr(torch.arange(0, 26, 2).int(), torch.arange(24).int() % 6, torch.from_numpy(generator.random(24)).float() * 1e4, 6)
    light = Headlight(name="light", rows=3, cols=4, left=0.1, right=-0.3, bottom=-0.2, top=0.1, matrix=matrix, pixel_rows=2, pixel_cols=3)
    lamp = Lamp("lamp", (Module("matrix", light, swivel_deg=(-5.0, 9.0)),), {"low": (torch.rand(6),)}, "made up")
    return _written(folder, ("lamp.npz", lambda path: archive.save(path, lamp)))


def _read_lamp(path: Path) -> None:
    for module in archive.load(path).modules:
        module.headlight.light_texture(torch.ones(module.headlight.n_pixels))


def _tables(folder: Path) -> dict[str, bytes]:
    h, v = np.linspace(-2, 2, 5), np.linspace(-1, 1, 3)
    candela = np.random.default_rng(0).random((2, 3, len(v), len(h)))
    lines = [f"{p},{a},{b},{(p + 1) * (2 - abs(a)):.3f}" for p in range(4) for a in h for b in v]
    csv = "\n".join(["pixel,horizontal_deg,vertical_deg,candela", *lines])
    return _written(
        folder,
        ("table.npz", lambda path: np.savez(path, candela=candela, horizontal_deg=h, vertical_deg=v)),
        ("table.csv", lambda path: path.write_text(csv)),
    )


_HEAD = ["maker", "1", "1", "4", "90", "3", "45", "report", "lamp", "no", "file", "date", *(["100"] * 9), "100", "100", "1", "0"]
_LIGHT = ["1", "1", "LED", "1000", "white", "80", "10", *(["0.5"] * 10), "0", "90", "180", "270", "0", "45", "90", *(["100.5"] * 3)]
LDT = "\n".join([*_HEAD, *_LIGHT]).encode()


def _photometry(folder: Path) -> dict[str, bytes]:
    angles = np.linspace(-20, 20, 9)
    table = Distribution("A", angles, angles, 900 * np.random.default_rng(0).random((9, 9)))
    return {**_written(folder, ("a.ies", lambda path: lm63.write(path, table))), "a.ldt": LDT}


def _roads(folder: Path) -> dict[str, bytes]:
    z = 0.01 * np.random.default_rng(0).random((60, 9))
    line = {"reference_line_start_u": 0.0, "reference_line_end_u": 29.5, "reference_line_increment": 0.5}
    mods = {"scale_z_grid": 1.0, "scale_length": 1.0, "scale_width": 1.0, "scale_curvature": 1.0, "grid_nan_mode": 2.0, "refpoint_u": 3.0}
    crg = Crg(z, np.linspace(-2, 2, 9), line, phi=np.linspace(0, 0.1, 60), options={"border_mode_u": 2.0}, modifiers=mods)
    return _written(folder, *((f"{kind}.crg", functools.partial(lambda kind, path: write_crg(path, crg, kind), kind)) for kind in KINDS))


KINDS = ("LRFI", "LDFI", "KRBI", "KDBI")


def _damaged_road(data: bytes, rng: random.Random) -> bytes:
    end = data.find(b"$$$$")
    if rng.random() < 0.7:
        return mutations.of_text(data[:end].decode("latin-1"), rng).encode("latin-1", "replace") + data[end:]
    return data[:end] + mutations.of_bytes(data[end:], rng)


def _read_road(path: Path) -> None:
    road = OpenCrgRoad(file=str(path))
    x, y = np.meshgrid(np.linspace(-6, 120, 40), np.linspace(-25, 25, 20))
    heights = road.z(x, y)
    road.grid()
    assert np.isfinite(heights).all(), "a road is finite everywhere"


def _pictures(folder: Path) -> dict[str, bytes]:
    picture = np.random.default_rng(0).integers(0, 255, (20, 30, 4), np.uint8)
    return {f"a{name}": cv2.imencode(name, picture[..., :channels])[1].tobytes() for name, channels in PICTURES.items()}


PICTURES = {".png": 4, ".jpg": 3, ".tif": 3, ".bmp": 3, ".webp": 3}
SVG = b"""<?xml version="1.0"?>
<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" width="40" height="20" viewBox="0 0 40 20">
<style>rect { fill: white }</style>
<defs><linearGradient id="g"><stop offset="0.5" stop-color="white"/></linearGradient></defs>
<rect id="r" x="10" y="0" width="20" height="10" fill="url(#g)"/>
<use xlink:href="#r" transform="translate(3, 4) scale(2)"/>
<path d="M 1 2 L 30 18 Q 3 4 5 6 Z" stroke="white" stroke-width="2" stroke-dasharray="1 2" opacity="0.5"/>
</svg>"""


def _videos(folder: Path) -> dict[str, bytes]:
    path = folder / "a.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for k in range(3):
        writer.write(np.full((48, 64, 3), 80 * k, np.uint8))
    writer.release()
    return {"a.avi": path.read_bytes()}


def _utilisations(folder: Path) -> dict[str, bytes]:
    values = np.random.default_rng(0).random((3, 4))
    return _written(
        folder,
        ("u.npy", lambda path: np.save(path, values)),
        ("u.npz", lambda path: np.savez(path, values)),
        ("u.csv", lambda path: np.savetxt(path, values, delimiter=",")),
    )


def _damaged_utilisation(data: bytes, rng: random.Random) -> bytes:
    if data.startswith(b"\x93NUMPY"):
        return rng.choice((mutations.of_array, mutations.of_bytes))(data, rng)
    return _archive_or(_text)(data, rng)


def _weights(folder: Path) -> dict[str, bytes]:
    return _written(folder, ("w.pt", lambda path: network.save(network.Network(2), ("car", "pedestrian"), path)))


def _parquet(folder: Path) -> dict[str, bytes]:
    table, other = pq.read_table(RECORDING), pa.table({"a": [1]})
    writers = ((name, functools.partial(pq.write_table, each)) for name, each in (("t.parquet", table), ("u.parquet", other)))
    return _written(folder, *writers)


def _read_recording(path: Path) -> None:
    replay.columns_of(read_parquet(path), pq.read_schema(RECORDING), path)


LIKE = torch.zeros(4)


def _frames(folder: Path) -> dict[str, bytes]:
    times = {"duration_s": 0.01, "light": 0, "taken_s": 0.0, "arrived_s": 0.0, "came_with": 0, "lost": False}
    samples = frames.sample_values([Sample("wheels", 0.005, 0.01, torch.ones(2)), Sample("gyro", 0.008, 0.009, torch.zeros(3))])
    rows = [{"number": k, "time_s": 0.01 * k, "samples": samples, **times} for k in range(3)]
    projection = ProjectionCommand(LIKE, warp=Warp(torch.rand(1, 2, 4, 3), torch.rand(1, 4, 3), (4.0, 2.0)))
    shown = Exposure(0, 0.0, 0.1, (Utilisation(torch.rand(6), slice(1, 5)),), {"symbol": projection}, (ModuleCommand(3.0, 1.0, 0.5),))
    light = frames.light_arrays(shown)
    return _written(
        folder,
        ("exposures.parquet", lambda path: pq.write_table(pa.Table.from_pylist(rows, frames.SCHEMA), path)),
        ("light.npz", lambda path: write_npz(path, light.items())),
        ("frame.png", lambda path: frames.write_image(path, torch.full((90, 160), 4095.0), 12)),
    )


def _read_frames(path: Path) -> None:
    if path.suffix == ".npz":
        frames.read_light(path, [6], LIKE.device)
    elif path.suffix == ".png":
        frames.read_image(path, CameraParams(width_px=160, height_px=90), LIKE)
    else:
        frames.read_exposures(path)


JOBS = b'{"id": "0123", "key": "a", "result": {"x": 1.5}}\n{"id": "4567", "key": "b", "result": {"x": null}}\n'
CORNERS = [f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1)]
OBJ = "\n".join([*CORNERS, "mtllib a.mtl", "usemtl m", "f 1 2 4 3", "f 5 6 8 7"]).encode()


def _calibration(folder: Path) -> dict[str, bytes]:
    camera = CameraModel(64, 48, np.array([[90.0, 0, 32], [0, 90, 24], [0, 0, 1]]), covariance=np.eye(9))
    pose = Pose(np.array([0.1, 0.2, 0.3]), np.ones(3))
    found = calibrations.Calibration(camera, linear_response(255), np.zeros(3), pose, {"left matrix": pose}, {"boards": 0.1})
    return _written(folder, ("rig.npz", lambda path: calibrations.save(path, found)))


def _meshes(folder: Path) -> dict[str, bytes]:
    import trimesh

    box = trimesh.creation.box((1, 2, 3))
    return {"a.obj": OBJ, **{f"a.{form}": bytes(box.export(file_type=form)) for form in ("ply", "stl", "glb")}}


def _read_mesh(path: Path) -> None:
    MeshParams(name="a", file=path, track=(KeyframeParams(position_m=(9, 0, 0)),)).build()


ALL: dict[str, Kind] = {
    "scenario": Kind(_scenarios, _text, lambda path: load(str(path)), 12),
    "resolved": Kind(_resolved, _nested, lambda path: validate(json.loads(path.read_bytes()), str(path)), 8),
    "override": Kind(_overrides, _override, lambda path: load(path.stem, [path.read_text()]), 12),
    "manifest": Kind(_manifests, _json, _read_manifest, 8),
    "campaign": Kind(lambda folder: {"c.toml": CAMPAIGN}, _text, campaign.read, 1),
    "faults": Kind(
        _example("rig_faults.toml"), _text, lambda path: Lens.of(faults.read(path).lens, CameraParams(width_px=64, height_px=48)), 2
    ),
    "data set": Kind(lambda folder: {"d.toml": DATASET}, _text, lambda path: dataset.read(path, 1), 1),
    "lamp description": Kind(lambda folder: {"lamp.toml": LAMP}, _text, description.build, 6),
    "lamp file": Kind(_lamp_files, mutations.of_archive, _read_lamp, 12),
    "table": Kind(_tables, _archive_or(_text), lambda path: TableSource(path=path, rows=2).pixels(), 8),
    "photometry": Kind(_photometry, _text, read_photometry, 8),
    "road": Kind(_roads, _damaged_road, _read_road, 12),
    "picture": Kind(_pictures, mutations.of_bytes, load_still, 8),
    "drawing": Kind(lambda folder: {"a.svg": SVG}, _text, load_still, 8),
    "video": Kind(_videos, mutations.of_bytes, video, 4),
    "utilisations": Kind(_utilisations, _damaged_utilisation, lambda path: read_utilisation(path, 3, 4), 8),
    "weights": Kind(_weights, mutations.of_archive, lambda path: network.load(path, torch.device("cpu")), 2),
    "recording": Kind(_parquet, mutations.of_bytes, _read_recording, 6),
    "frames": Kind(_frames, _archive_or(mutations.of_bytes), _read_frames, 6),
    "jobs": Kind(lambda folder: {"jobs.jsonl": JOBS}, _either, lambda path: run_jobs(dict, [], path, version=""), 4),
    "calibration": Kind(_calibration, _either, calibrations.load, 4),
    "lens": Kind(_calibration, _either, load_lens, 2),
    "rig": Kind(_example("rig.toml"), _text, load_rig, 2),
    "mesh": Kind(_meshes, _either, _read_mesh, 8),
    "studio message": Kind(messages.of_studio, messages.damaged, messages.read_studio, 8),
    "plant message": Kind(messages.of_plant, messages.damaged, messages.read_plant, 8),
    "glTF": Kind(lambda folder: {f"{k}.gltf": json.dumps(each).encode() for k, each in enumerate(RIGHT.values())}, _json, _read_mesh, 8),
}
BUILT = Kind(_overrides, _override, _overridden)  # what `luxloop check` does, a second or two each
