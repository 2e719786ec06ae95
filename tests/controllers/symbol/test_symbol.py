"""Symbol controllers: what they see on a flat road, what they do about it, and that the loop closes without any rendering."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from luxloop.controllers.pixels.primitives import road_symbol
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.controllers.symbol import CONTROLLERS, build_controller
from luxloop.controllers.symbol.feedback import LATENCY_GAINS, PidTuning, ThesisPid, ThesisPidParams
from luxloop.controllers.symbol.heights.feedforward import OpenLoop, OpenLoopParams
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand, Warp
from luxloop.controllers.symbol.sensing.projector import DrawingModule, Projector, SymbolParams
from luxloop.controllers.symbol.sensing.symbol_sensor import (
    FeatureParams,
    Measurement,
    Observation,
    Projection,
    SymbolController,
    SymbolSensor,
    flat_model,
)
from luxloop.perception import appearance
from luxloop.perception.appearance import Appearance
from luxloop.perception.camera import CameraParams, average_rows, camera_view, expose
from luxloop.perception.extraction import ExtractionParams, ExtractionStatus
from luxloop.perception.noise import FrameNoise
from luxloop.world.frames import pose_from_degrees
from luxloop.world.lamps.presets import idealised
from luxloop.world.light.emitters import ambient_luminance
from luxloop.world.light.illumination import added_light
from luxloop.world.materials.library import RoadSurfaceParams
from luxloop.world.rendering.gbuffer import flat_road
from luxloop.world.symbols import load_still
from luxloop.world.texels import Window

SYMBOLS = ["snowflake", "chevrons", "warning_triangle", "distance_warning"]
RAW, PLANE = FeatureParams(), FeatureParams(view="birdseye", shape="moments")
# The part of the default camera's image that the symbol moves in, as fine as there. With coarser pixels, or lamp rows than the default's,
# the horizontal strokes of some symbols look alike at poses several centimetres apart.
CAMERA = CameraParams(width_px=640, height_px=240, hfov_deg=16, pitch_deg=4.2)
AMBIENT_LX = 0.3
TARGET = torch.tensor([17.0, 0.0, 0.0, 0.0])
PARAMS = ThesisPidParams()


@cache
def lamps() -> tuple[DrawingModule, DrawingModule]:
    ssc = Ssc.prepare(idealised(pixel_cols=160))
    return DrawingModule("left", ssc, pose_from_degrees((0.0, 0.6, 0.75))), DrawingModule(
        "right", ssc, pose_from_degrees((0.0, -0.6, 0.75))
    )


@cache
def projector(symbol: str = "snowflake", n_lamps: int = 1) -> Projector:
    image = load_still(Path(__file__).parents[3] / "scenarios" / "symbols" / f"{symbol}.png")
    return Projector(lamps()[:n_lamps], image, SymbolParams(image=symbol), camera_view(CAMERA).origin)


@cache
def sensor(symbol: str = "snowflake", what: FeatureParams = RAW, edges: str = "grey", n_lamps: int = 1) -> SymbolSensor:
    extraction = ExtractionParams(edges=edges)
    model = flat_model(projector(symbol, n_lamps), CAMERA, RoadSurfaceParams(), AMBIENT_LX, extraction, what)
    return SymbolSensor(projector(symbol, n_lamps), model, CAMERA, extraction)


@cache
def ambient() -> Tensor:
    road = flat_road(camera_view(CAMERA).with_rows(CAMERA.oversampling), RoadSurfaceParams().albedo)
    return average_rows(ambient_luminance(road, AMBIENT_LX), CAMERA.oversampling)


def frames(luminance: Tensor, step: int | None = None) -> tuple[Tensor, Tensor]:
    """On and off frames of added light; with noise where a step is given."""
    noise = (None, None) if step is None else (FrameNoise.of(1, step, 0), FrameNoise.of(1, step, 1))
    off = ambient().expand(luminance.shape)
    return expose(off + luminance, CAMERA, noise[0]), expose(off, CAMERA, noise[1])


def measure(watcher: SymbolSensor, shown: Tensor, step: int | None = None) -> Measurement:
    lights = watcher.projector.light(shown)
    return watcher.measure(frames(watcher.model.luminance(lights), step), ProjectionCommand(shown), lights)


# The flat model


@pytest.mark.parametrize("symbol", SYMBOLS)
@pytest.mark.parametrize("edges", ["grey", "binary"])
def test_signs_of_the_four_errors_in_the_camera_image(symbol, edges):
    y_by_x, x_by_y, roll, pitch = sensor(symbol, RAW, edges).model.gains.tolist()
    assert y_by_x < 0, "farther is higher in the image"
    assert x_by_y < 0, "left is left"
    assert roll > 0
    assert pitch > 0


@pytest.mark.parametrize("symbol", SYMBOLS)
def test_in_the_birds_eye_view_a_metre_is_a_metre(symbol):
    gains = sensor(symbol, PLANE).model.gains
    # Along the symbol there are some 40 px and lamp rows: a tenth of one over a probe of 0.6 m is 2 %, more with strokes across.
    assert_close(gains[:1], torch.tensor([-1.0]), rtol=0.04, atol=0)
    assert_close(gains[1:2], torch.tensor([-1.0]), rtol=0.01, atol=0)


# The sensor

offsets = st.tuples(st.floats(-6, 10), st.floats(-2, 2), st.floats(-0.12, 0.12), st.floats(-0.07, 0.03))


@given(offsets, st.floats(0, 1), st.floats(0, 1), st.floats(-0.15, 0.15), st.none() | st.floats(-0.2, 0.2), st.booleans())
def test_footprint_holds_what_the_lamp_can_draw_on_an_uneven_road(offset, u, v, height_m, z, warped):
    pose = (TARGET + torch.tensor(offset)).double()
    view = camera_view(CAMERA)
    larger = Warp(torch.zeros(1, 2, 2, 2), torch.ones(1, 2, 2), (7.2, 2.6)) if warped else None
    crop = projector().footprint(ProjectionCommand(pose, None if z is None else torch.tensor(z), larger), view, 0.15)
    length_m, width_m = larger.size_m if larger else (4.0, 2.0)
    primitive = road_symbol(pose, 0.0, width_m, length_m, torch.ones(1, 1), 1.0, "u_abs")
    point = (primitive.origin + u * primitive.d1 + v * primitive.d2)[0] + torch.tensor([0.0, 0.0, z or 0.0])
    lamp = lamps()[0].T_body_headlight[:3, 3]
    ray = point - lamp
    if ray[2] >= 0 or (height_m - lamp[2]) / ray[2] * ray.norm() > 200:
        return  # comes down nowhere near
    (column, row), depth = view.project((lamp + ray * (height_m - lamp[2]) / ray[2])[:, None])
    assert depth > 0
    if 0 <= column < view.width and 0 <= row < view.height:
        assert crop.u_start <= column <= crop.u_stop
        assert crop.v_start <= row <= crop.v_stop


@pytest.mark.parametrize("what", [RAW, PLANE], ids=["raw", "birdseye"])
@pytest.mark.parametrize("symbol", SYMBOLS)
def test_at_the_target_there_is_no_error(symbol, what):
    seen = measure(sensor(symbol, what), TARGET)
    assert seen.code == ExtractionStatus.SEEN
    # Twelve bits of quantisation are all that differs from the model: they average out to a few thousandths of a pixel.
    assert seen.area_ratio.item() == pytest.approx(1, abs=0.001)
    assert (seen.pose_error.abs() < torch.tensor([5e-4, 1e-4, 1e-4, 1e-4])).all()


@pytest.mark.parametrize("what", [RAW, PLANE], ids=["raw", "birdseye"])
@pytest.mark.parametrize("k", range(4))
def test_errors_are_scaled_to_metres_and_radians(what, k):
    offset = torch.zeros(4)
    offset[k] = (0.4, 0.2, math.radians(2), math.radians(-0.5))[k]
    seen = measure(sensor("snowflake", what), TARGET + offset)
    # Linear, but for the roll of quadrants that strokes leave and enter: within a quarter at twice the probe.
    linear = 0.25 if k == 2 and what is RAW else 0.05
    assert seen.pose_error[k].item() == pytest.approx(offset[k].item(), rel=linear)


def test_a_batch_is_a_loop_of_singles():
    poses = TARGET + torch.tensor([[0.0, 0, 0, 0], [0.5, -0.2, 0.02, 0.0], [0.0, 30.0, 0, 0]])
    batch = measure(sensor(), poses)
    assert batch.errors.shape == batch.pose_error.shape == (3, 4)
    for k, pose in enumerate(poses):
        single = measure(sensor(), pose)
        assert batch.code[k] == single.code
        # The crop is that of the whole batch: other sums.
        assert_close(batch.errors[k], single.errors, equal_nan=True, rtol=1e-3, atol=1e-3)
    assert batch.code.tolist() == [ExtractionStatus.SEEN, ExtractionStatus.SEEN, ExtractionStatus.NOTHING]


def test_light_beside_the_footprint_is_ignored():
    watcher, lights = sensor(), projector().light(TARGET)
    clean = measure(watcher, TARGET)
    glare = watcher.model.luminance(lights)
    beside = torch.ones_like(glare, dtype=torch.bool)
    beside[clean.crop.slices] = False
    seen = watcher.measure(frames(glare + 5.0 * beside), ProjectionCommand(TARGET), lights)
    assert_close(seen.errors, clean.errors, rtol=0, atol=0)


def test_reasons_for_loss():
    watcher, lights = sensor(), projector().light(TARGET)
    symbol = watcher.model.luminance(lights)
    left_part = symbol * (torch.arange(CAMERA.width_px) < 0.47 * CAMERA.width_px)
    assert watcher.measure(None, ProjectionCommand(TARGET), lights).code == ExtractionStatus.NO_FRAME
    assert watcher.measure(frames(torch.zeros_like(symbol), step=1), ProjectionCommand(TARGET), lights).code == ExtractionStatus.NOTHING
    assert watcher.measure(frames(left_part), ProjectionCommand(TARGET), lights).code == ExtractionStatus.TOO_SMALL
    assert watcher.measure(frames(symbol + 5.0), ProjectionCommand(TARGET), lights).code == ExtractionStatus.TOO_LARGE
    aside = TARGET + torch.tensor([0.0, 30.0, 0.0, 0.0])
    lost = watcher.measure(frames(symbol), ProjectionCommand(aside), projector().light(aside))
    assert lost.code == ExtractionStatus.NOTHING
    assert lost.errors.isnan().all()
    assert lost.symbol.numel() == 0


# The controllers


def pose_of(controller: SymbolController, state: Any) -> Tensor:
    projection = controller.projection(state, None)
    assert projection.warp is None and projection.z is None
    return projection.pose


def report(pose_error: Tensor, code: Tensor | int = ExtractionStatus.SEEN) -> Observation:
    """What a sensor would say."""
    nan = torch.full(pose_error.shape[:-1], torch.nan)
    shape = Appearance(nan, nan[..., None, None].expand(*nan.shape, 5, 2), nan, nan)
    code = torch.as_tensor(code).expand(pose_error.shape[:-1])
    seen = Measurement(code, pose_error, pose_error, nan, shape, torch.zeros(0, 0), Window(0, 0, 0, 0))
    return Observation(seen, None, Projection(ProjectionCommand(pose_error), ()))


def thesis_pid() -> ThesisPid:
    return ThesisPid.prepare(PARAMS, TARGET)


RANGES = torch.tensor([[8.0, 40.0], [-6.0, 6.0], [math.radians(-7), math.radians(7)], [math.radians(-4), math.radians(2.2)]])
RATES = torch.tensor([1.5, 0.9, math.radians(2.4), math.radians(1.35)])
START = torch.tensor([15.0, 0.8, math.radians(5), math.radians(-2)])


def test_controllers_go_by_name():
    assert set(CONTROLLERS) == {"luxloop", "open", "feedforward", "thesis_pid", "gauss_newton", "model_reference"}
    for name, params in CONTROLLERS.items():
        assert params().name == name
    assert isinstance(build_controller(OpenLoopParams(), sensor()), OpenLoop)
    assert isinstance(build_controller(PARAMS, sensor()).inner, ThesisPid)


@given(st.lists(st.tuples(st.tuples(*[st.floats(-1e3, 1e3)] * 4), st.sampled_from(list(ExtractionStatus))), max_size=12))
def test_limits_are_never_exceeded(reports):
    controller, state = thesis_pid(), thesis_pid().start(START)
    for pose_error, code in reports:
        before = pose_of(controller, state)
        state = controller.step(state, report(torch.tensor(pose_error), int(code)))
        pose = pose_of(controller, state)
        slack = 1e-5  # float32
        assert ((pose >= RANGES[:, 0] - slack) & (pose <= RANGES[:, 1] + slack)).all()
        was_reset = torch.equal(pose, TARGET)
        assert was_reset or ((pose - before).abs() <= RATES + slack).all()


def test_the_measured_latency_schedules_the_gains():
    scheduled = ThesisPid.prepare(ThesisPidParams(gain_schedule="latency"), TARGET)
    error = torch.full((4,), 0.01)
    first_moves = []
    for latency in range(6):
        after = scheduled.step(scheduled.start(START), replace(report(error), latency_steps=latency))
        first_moves.append(pose_of(scheduled, after) - START)
    for latency, (kp, _) in enumerate((*LATENCY_GAINS, LATENCY_GAINS[-1], LATENCY_GAINS[-1])):
        assert_close(first_moves[latency], -kp * error, rtol=0, atol=1e-5)
    fixed = thesis_pid()
    late, early = (fixed.step(fixed.start(START), replace(report(error), latency_steps=latency)) for latency in (3, 0))
    assert torch.equal(pose_of(fixed, late), pose_of(fixed, early))
    with pytest.raises(ValueError, match=r'gain_schedule = "latency" has its own gains; leave out position or gain_schedule'):
        ThesisPidParams(gain_schedule="latency", position=PidTuning(kp=0.3, ki=0.0, kd=0.0))


def test_holds_while_frames_are_missing():
    controller = thesis_pid()
    state = controller.step(controller.start(START), report(torch.full((4,), 0.05)))
    held = state
    for _ in range(10):
        held = controller.step(held, report(torch.full((4,), torch.nan), ExtractionStatus.NO_FRAME))
    for name, value in vars(state.pid).items():
        assert torch.equal(getattr(held.pid, name), value), name
    assert held.losses == 0


@pytest.mark.parametrize("reason", [ExtractionStatus.NOTHING, ExtractionStatus.TOO_SMALL, ExtractionStatus.TOO_LARGE])
def test_starts_anew_at_the_flat_road_pose_after_two_losses(reason):
    controller = thesis_pid()
    lost, missing = report(torch.full((4,), torch.nan), reason), report(torch.full((4,), torch.nan), ExtractionStatus.NO_FRAME)
    once = controller.step(controller.start(START), lost)
    assert torch.equal(pose_of(controller, once), START), "held after the first loss"
    between = controller.step(once, missing)
    assert torch.equal(pose_of(controller, between), START), "a missing frame is no loss, and does not make up for one"
    twice = controller.step(between, lost)
    assert torch.equal(pose_of(controller, twice), TARGET)
    fresh = controller.start(TARGET)
    for name, value in vars(fresh.pid).items():
        assert torch.equal(getattr(twice.pid, name), value), name
    assert twice.losses == 0
    seen = controller.step(once, report(torch.full((4,), 0.01)))
    moved, again = pose_of(controller, seen), controller.step(seen, lost)
    assert torch.equal(pose_of(controller, again), moved) and not torch.equal(moved, TARGET), "a symbol that is seen forgives a loss"
    broken = controller.step(seen, report(torch.tensor([0.0, 0.0, torch.nan, 0.0])))
    assert broken.losses == 1 and torch.equal(pose_of(controller, broken), moved), "an error that is no number is one"


def test_a_batch_of_states_equals_singles(device):
    generator = torch.Generator().manual_seed(1)
    errors = torch.randn(6, 5, 4, generator=generator) * 0.2
    codes = torch.randint(0, 5, (6, 5), generator=generator)
    batched = ThesisPid.prepare(PARAMS, TARGET.to(device))
    state = batched.start(START.expand(5, 4).to(device))
    singles = [thesis_pid().start(START) for _ in range(5)]
    for error, code in zip(errors, codes, strict=True):
        state = batched.step(state, report(error.to(device), code.to(device)))
        singles = [thesis_pid().step(single, report(e, c)) for single, e, c in zip(singles, error, code, strict=True)]
    assert pose_of(batched, state).device.type == device.type
    assert_close(pose_of(batched, state).cpu(), torch.stack([single.pid.output for single in singles]), rtol=0, atol=1e-6)
    assert state.losses.tolist() == [int(single.losses) for single in singles]


def test_open_loop_ignores_everything():
    controller = build_controller(OpenLoopParams(), sensor())
    state = controller.start(START)
    for code in ExtractionStatus:
        state = controller.step(state, report(torch.full((4,), 1.0), int(code)))
        assert torch.equal(pose_of(controller, state), TARGET)
    assert pose_of(controller, controller.start(START.expand(3, 4))).shape == (3, 4)


def run(watcher: SymbolSensor, start: Tensor, steps: int = 30, drop_every: int | None = None) -> Tensor:
    """Poses `[steps, 4]` of a loop around the flat model with camera noise."""
    controller = thesis_pid()
    state, poses = controller.start(start), []
    for step in range(steps):
        pose = pose_of(controller, state)
        poses.append(pose)
        lights = watcher.projector.light(pose)
        seen_frames = frames(watcher.model.luminance(lights), step)
        dropped = drop_every is not None and step % drop_every == 1
        state = controller.step(
            state,
            Observation(
                watcher.measure(None if dropped else seen_frames, ProjectionCommand(pose), lights),
                None,
                Projection(ProjectionCommand(pose), lights),
            ),
        )
    return torch.stack(poses)


# A quarter of the symbol's size in per cent; turned by as little, the corners move by no more. Noise alone moves x by 3 mm a step.
CLOSE = torch.tensor([0.01, 0.005, math.radians(0.05), math.radians(0.02)])


@pytest.mark.parametrize("what", [RAW, PLANE], ids=["raw", "birdseye"])
@pytest.mark.parametrize("symbol", SYMBOLS)
def test_the_loop_closes_on_a_flat_road(symbol, what):
    poses = run(sensor(symbol, what), START)
    assert ((poses[-5:].mean(0) - TARGET).abs() < CLOSE).all()


def test_a_fifth_degree_of_freedom_is_one_entry_and_its_keys(monkeypatch):
    """With an entry for yaw, poses, features, gains and errors have five numbers, and the PIDs turn the symbol back."""

    class YawParams(ThesisPidParams):
        yaw_range_deg: tuple[float, float] = (-7.0, 7.0)
        yaw_rate_deg: float = 2.4

    def lean(seen: Appearance, shape: str) -> Tensor:
        top_left, top_right, bottom_left, bottom_right = seen.centroids[..., 1:, 0].unbind(-1)
        return (top_left + top_right - bottom_left - bottom_right) / 2

    def of_pose(T: Tensor) -> Tensor:
        return torch.atan2(T[..., 1, 0], T[..., 0, 0])

    yaw = appearance.DegreeOfFreedom("yaw", "rad", math.radians(2.0), "yaw", lean, of_pose, "shown yaw", ("feature", "error of yaw"))
    monkeypatch.setattr(appearance, "DEGREES", (*appearance.DEGREES, yaw))
    watcher = sensor.__wrapped__("chevrons")
    target = watcher.projector.target
    shown = target + torch.tensor([0.0, 0.0, 0.0, 0.0, math.radians(3.0)])
    seen = measure(watcher, shown)
    assert seen.errors.shape == (5,) and watcher.model.gains.shape == (5,)
    assert float(seen.pose_error[4]) == pytest.approx(math.radians(3.0), rel=0.1)  # the feature is not quite linear in the angle
    law = ThesisPid.prepare(YawParams(), target)
    after = law.step(law.start(shown), report(seen.pose_error))
    assert 0 < float(after.pid.output[4]) < float(shown[4])
    assert yaw.of_pose(pose_from_degrees((0.0, 0.0, 0.0), yaw_deg=3.0)) == pytest.approx(math.radians(3.0))


def test_the_loop_closes_with_two_lamps_and_survives_dropped_frames():
    poses = run(sensor("snowflake", PLANE, n_lamps=2), START, steps=40, drop_every=3)
    assert torch.equal(poses[2], poses[1])
    assert ((poses[-5:].mean(0) - TARGET).abs() < CLOSE).all()


def test_converges_on_an_ideal_plant():
    controller, state, poses = thesis_pid(), thesis_pid().start(START), []
    for _ in range(40):
        pose = pose_of(controller, state)
        poses.append(pose)
        state = controller.step(state, report(pose - TARGET))
    error = (torch.stack(poses) - TARGET) / (START - TARGET)
    # Spectral radius 0.65 (position) and 0.75 (rotation): 2 % after 9 to 14 steps, and some for the rate limits.
    assert error[20:].abs().max() < 0.02
    # 38 % and 21 % is what the gains overshoot by without rate limits.
    assert -error[:, :2].min() < 0.4
    assert -error[:, 2:].min() < 0.25


def test_the_light_of_two_lamps_adds_up_to_that_of_one():
    both = sensor(n_lamps=2).model
    lights = projector(n_lamps=2).light(TARGET)
    parts = [added_light((t,), (light,), torch.zeros_like(both.limit)) for t, light in zip(both.transports, lights, strict=True)]
    assert_close(both.luminance(lights), parts[0] + parts[1])
    one = sensor().model.luminance(projector().light(TARGET))
    # The setpoint is shared; the lamps see the symbol from 1.2 m apart, which changes cos / d^2 by less than a hundredth.
    assert both.luminance(lights).sum().item() == pytest.approx(one.sum().item(), rel=0.02)
