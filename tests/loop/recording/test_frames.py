"""Frames that a run keeps: what its plant was shown and handed over, bit for bit, whole or gone with the recording."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import torch

from luxloop import Exposure, Frame, LuxloopError, ProjectionCommand, Sample, Simulation, run, validate
from luxloop.controllers.symbol.sensing.projection import Warp
from luxloop.loop.recording.manifest import Manifest
from luxloop.loop.recording.recorder import Recorder
from luxloop.loop.simulation.frames import (
    FOLDER,
    SCHEMA,
    TABLE,
    image_file,
    light_arrays,
    light_file,
    read_exposures,
    read_image,
    read_light,
    read_samples,
    write_image,
)
from luxloop.perception.camera import CameraParams
from luxloop.world.arrays import write_npz
from tests.loop.conftest import SMALL, toml

DRIVES = {
    "steps": 6,
    "vehicle": {"course": [{"speed_m_s": 10.0}]},
    "road": {"kind": "bumps"},
    "sensors": toml("{ attitude.heave_noise_m = 0.01, gyro = { rate_hz = 200, delay_s = 0.01 } }"),
    "camera": SMALL["camera"] | {"latency_steps": 1, "drop_probability": 0.3},
    "headlight": {"model": "ssl-hd-lores", "lamps": ["left"]},
    "lighting": {"base": {"beam": "low"}},
    "functions": {
        "symbol": SMALL["functions"]["symbol"] | toml("{ value = 0.5, width_m = 4.0, length_m = 8.0, controller.name = 'luxloop' }")
    },
}


def same(given: tuple[Sample, ...], others: tuple[Sample, ...]) -> bool:
    def told(samples: tuple[Sample, ...]) -> list[Any]:
        return [(each.sensor, each.measured_s, each.arrived_s, each.values.tolist()) for each in samples]

    return told(given) == told(others)


DRAWS = {"steps": 3, "headlight": SMALL["headlight"] | {"rate_hz": 120}, "camera": SMALL["camera"] | {"exposure_s": 0.004}}


@pytest.mark.parametrize("changes", [{"steps": 4}, pytest.param(DRIVES, marks=pytest.mark.slow), DRAWS], ids=["stands", "drives", "draws"])
def test_all_that_was_shown_and_came_is_kept_bit_for_bit(changes, tmp_path):
    simulation = Simulation.prepare(validate({**SMALL, **changes}, "small"))
    with Recorder(tmp_path, simulation, frames=True) as recorder:
        results = list(simulation.evaluations())
        for result in results:
            recorder.add(result)
    exposures = [each for result in results for each in result.exposures]
    arrivals = [results[0].reception.arrivals[0], *(each for result in results for each in result.reception.arrivals[1:])]
    rows, camera, like = read_exposures(tmp_path / TABLE), simulation.scenario.camera, simulation.symbol.projector.target
    assert len(rows) == len(exposures) + 1 and pq.read_schema(tmp_path / TABLE).equals(SCHEMA, check_metadata=True)
    for row, exposure, before in zip(rows, exposures, arrivals, strict=False):
        assert (row["number"], row["time_s"], row["duration_s"]) == (exposure.number, before.time_s, exposure.duration_s)
        assert same(read_samples(row, like), before.samples)
        pixels = [light.u.numel() for light in exposure.lights]
        lights, projections, _ = read_light(light_file(tmp_path, row["light"]), pixels, like.device)
        asked = exposure.projections
        assert all(a.u.equal(b.u) and a.band == b.band for a, b in zip(lights, exposure.lights, strict=True))
        assert projections.keys() == asked.keys() and all(projections[name].shows(asked[name]) for name in asked)
    assert same(read_samples(rows[-1], like), arrivals[-1].samples) and rows[-1]["time_s"] == arrivals[-1].time_s
    came = {frame.number: (frame, each) for each, after in zip(exposures, arrivals[1:], strict=True) for frame in after.frames}
    assert {row["number"] for row in rows if row["came_with"] is not None} == came.keys()
    for number, (frame, exposure) in came.items():
        row = rows[number]
        assert (row["taken_s"], row["arrived_s"], row["came_with"]) == (frame.taken_s, frame.arrived_s, exposure.number)
        assert row["lost"] == (frame.image is None) != image_file(tmp_path, number).exists()
        assert frame.image is None or read_image(image_file(tmp_path, number), camera, like).equal(frame.image)
    lost = [frame.image is None for frame, _ in came.values()]
    assert any(lost) == bool(camera.drop_probability) and not all(lost)
    assert {bool(each.projections) for each in exposures} == {True, False}
    light_files = len(list((tmp_path / FOLDER).glob("light_*")))
    assert light_files <= len(results) + 1, "off exposures share one light"


def test_a_warped_drawing_is_kept_bit_for_bit(tmp_path, small_simulation):
    target, generator = small_simulation.symbol.projector.target, torch.Generator().manual_seed(0)
    warp = Warp(torch.rand((1, 2, 8, 4), generator=generator), torch.rand((1, 8, 4), generator=generator), (4.1, 2.3))
    numbers = torch.rand(6, generator=generator)
    lights = small_simulation.symbol.projector.resting
    projection = ProjectionCommand(target, numbers[0], warp, tuple(light.u for light in lights), target + 1, numbers[1:3])
    write_npz(tmp_path / "light.npz", light_arrays(Exposure(0, 0.0, 0.1, lights, {"mine": projection})).items())
    _, projections, _ = read_light(tmp_path / "light.npz", [light.u.numel() for light in lights], target.device)
    (again,) = (projections[name] for name in projections if name == "mine")
    assert again.shows(projection) and again.aim is not None and again.aim.equal(numbers[1:3])
    assert again.warp is not None and again.warp.size_m == warp.size_m


def test_functions_without_a_symbol_that_is_held_keep_frames(tmp_path):
    given = ["camera.width_px=160", "camera.height_px=90", "camera.oversampling=1", "renderer=raycast"]
    seen: list[Any] = []
    run("gfhb", tmp_path, frames=True, video=False, report=False, on_step=seen.append, overrides=given, steps=3)
    rows = read_exposures(tmp_path / TABLE)
    assert len(rows) == 4 and all(row["samples"] == "[]" for row in rows), "it stands"
    camera = CameraParams.model_validate(Manifest.read(tmp_path).scenario["camera"])
    for row, result in zip(rows, seen, strict=False):
        assert read_image(image_file(tmp_path, row["number"]), camera, result.frame).equal(result.frame)
        lights, projections, _ = read_light(light_file(tmp_path, row["light"]), [u.numel() for u in result.lights], result.frame.device)
        assert not projections and all(light.u.equal(u) for light, u in zip(lights, result.lights, strict=True))


@pytest.mark.parametrize(("bits", "dtype"), [(8, np.uint8), (12, np.uint16)])
def test_frames_of_eight_bits_are_pictures_that_every_program_shows(bits, dtype, tmp_path):
    camera = CameraParams(width_px=32, height_px=16, bits=bits)
    image = torch.arange(512.0).view(16, 32).remainder(2**bits)
    write_image(tmp_path / "frame.png", image, bits)
    coded = cv2.imread(str(tmp_path / "frame.png"), cv2.IMREAD_UNCHANGED)
    assert coded.dtype == dtype and read_image(tmp_path / "frame.png", camera, image).equal(image)


def test_old_frames_go_with_their_recording_and_nothing_else(tmp_path, small_simulation, small_results):
    directory, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    for results in (small_results[:3], small_results[:1]):
        with Recorder(directory, small_simulation, frames=True) as recorder:
            for result in results:
                recorder.add(result)
    assert [row["number"] for row in read_exposures(directory / TABLE)] == [0, 1, 2]
    assert len(list((directory / FOLDER).glob("frame_*.png"))) == 2
    (directory / FOLDER / "notes.txt").write_text("mine")
    Recorder(directory, small_simulation).add(small_results[0])
    assert [file.name for file in (directory / FOLDER).iterdir()] == ["notes.txt"]
    (directory / FOLDER / "notes.txt").unlink()
    (directory / FOLDER).rmdir()
    elsewhere.mkdir()
    (elsewhere / "frame_00000000.png").write_text("of somebody else")
    (directory / FOLDER).symlink_to(elsewhere)
    Recorder(directory, small_simulation).add(small_results[0])
    assert not (directory / FOLDER).exists() and (elsewhere / "frame_00000000.png").exists()


@pytest.mark.parametrize("value", [0.5, -1.0, 4096.0, float("nan")])
def test_frames_that_would_not_be_kept_as_they_are_are_refused(value, tmp_path, small_simulation, small_results):
    reception = small_results[0].reception
    before, after, _ = reception.arrivals
    (frame,) = after.frames
    assert frame.image is not None
    broken: Frame = replace(frame, image=torch.full_like(frame.image, value))
    broken_reception = replace(reception, exposures=reception.exposures[:1], arrivals=(before, replace(after, frames=(broken,))))
    result = replace(small_results[0], reception=broken_reception)
    with pytest.raises(LuxloopError, match=r"frame_00000000.png: cannot be stored, .* 0 to 4095; check the plant with luxloop.check_plant"):
        Recorder(tmp_path, small_simulation, frames=True).add(result)
