"""Rows mix the light of their exposure; frames keep their order, and what is lost is not sent."""

import math
import threading
import time
import zlib

import cv2
import numpy as np
import pytest

from luxloop.loop.rig.simulated.camera import FrameTruth, RigCamera, encode, flicker, read_out, shares
from luxloop.loop.rig.simulated.faults import CameraErrorParams, FaultParams, FlickerParams
from luxloop.loop.rig.simulated.lamp import Segment, Timeline
from luxloop.loop.rig.simulated.scene import RigScene
from luxloop.loop.rig.wire.mjpeg import JPEG, PNG, Part
from luxloop.perception.camera import CameraParams
from tests.loop.rig.simulated.conftest import DARK, faults_of, light, scenario_of


def test_a_row_takes_of_each_light_what_falls_into_its_exposure():
    starts_s = 10.0 + 0.02 * np.arange(40) / 40
    segments = [Segment(9.0, 10.012, None), Segment(10.012, 10.03, None), Segment(10.03, 11.0, None)]
    each = np.stack([shares(segment, starts_s, 0.015) for segment in segments])
    assert np.allclose(each.sum(0), 1, atol=1e-6)
    moments = starts_s[:, None] + 0.015 * (np.arange(2000) + 0.5) / 2000
    sampled = np.stack([((moments >= s.from_s) & (moments < s.to_s)).mean(1) for s in segments])
    assert abs(each - sampled).max() < 1e-3
    assert (shares(segments[0], np.full(40, 10.0), 0.015) == np.float32(0.8)).all(), "of a global shutter all rows are alike"


def test_flicker_is_integrated_over_the_exposure():
    starts_s, params = 1234.5 + 0.001 * np.arange(30), FlickerParams(depth=0.4)
    moments = starts_s[:, None] + 0.003 * (np.arange(3000) + 0.5) / 3000
    assert abs(flicker(params, starts_s, 0.003) - (1 + 0.4 * np.cos(200 * math.pi * moments)).mean(1)).max() < 1e-4
    assert abs(flicker(params, starts_s, 0.02) - 1).max() < 1e-6, "an exposure of two periods does not see it"


@pytest.mark.parametrize(("bits", "kind", "dtype"), [(12, "png", np.uint16), (8, "png", np.uint8), (8, "jpeg", np.uint8)])
def test_frames_are_coded_as_said(bits, kind, dtype):
    ramp = np.tile(np.linspace(0, 2**bits - 1, 160).astype(np.uint16), (120, 1))
    part = encode(ramp, bits, CameraErrorParams(encoding=kind))
    back = cv2.imdecode(np.frombuffer(part.body, np.uint8), cv2.IMREAD_UNCHANGED)
    assert part.kind == (JPEG if kind == "jpeg" else PNG) and back.dtype == dtype
    assert abs(back.astype(int) - ramp).max() <= (3 if kind == "jpeg" else 0)


def test_response_has_gamma_and_black_level():
    camera = CameraParams(noise=False)
    white = camera.saturation_e / (camera.exposure_s * camera.sensitivity_e_per_cd_s_m2)
    ramp = np.linspace(0, white, 50, dtype=np.float32)[None]
    codes = read_out(ramp, camera.model_copy(update={"gamma": 2.2}), faults_of("camera.black_level=0.1"), 0)[0]
    assert abs(codes - 4095 * (0.1 + 0.9 * np.linspace(0, 1, 50) ** (1 / 2.2))).max() < 4  # of 4095; near black gamma's slope is infinite
    noisy = read_out(np.full((50, 50), white / 2, np.float32), CameraParams(), FaultParams(), 3)
    assert noisy.std() / 4095 == pytest.approx(math.sqrt(504) / 1000, rel=0.05)  # 500 electrons and 2 of read noise


def taken(seconds: float, *keys: str) -> tuple[list[tuple[float, Part, FrameTruth]], RigCamera]:
    """Frames of a short run in the light of a frame each 20 ms, with the times of their sending."""
    sent = list[tuple[float, Part, FrameTruth]]()
    rig_scene, faults = RigScene(scenario_of(*DARK, "camera.exposure_s=0.004"), faults_of(*keys)), faults_of(*keys)
    timeline = Timeline(0.1)
    rig_scene.light(light(np.zeros(rig_scene.pixels, np.uint8)), 0.0)
    camera = RigCamera(rig_scene, timeline, faults, lambda part, exposed: sent.append((time.monotonic(), part, exposed)))
    thread = threading.Thread(target=camera.run)
    thread.start()
    for k in range(round(seconds / 0.02)):
        timeline.show(light(np.full(rig_scene.pixels, 50 * (k % 2), np.uint8), k))
        time.sleep(0.02)
    camera.ended = True
    thread.join()
    camera.close()
    return sent, camera


def test_frames_come_late_in_order_or_not_at_all():
    keys = ("camera.rate_hz=50", "camera.latency_s=0.05", "camera.jitter_s=0.08", "camera.loss=0.5", "camera.readout_s=0.015")
    sent, camera = taken(1.0, *keys)
    late = [at_s - exposed.exposed_to_s for at_s, _, exposed in sent]
    assert min(late) >= 0.05 and max(late) - min(late) > 0.02
    indices = [exposed.index for _, _, exposed in sent]
    assert indices == sorted(indices)
    assert all(zlib.crc32(part.body) == exposed.crc32 for _, part, exposed in sent)
    assert 0.2 < camera.lost / camera.exposures < 0.8 and len(sent) <= camera.exposures - camera.lost  # of 50 at one half
    assert all(exposed.exposed_to_s - exposed.exposed_from_s == pytest.approx(0.019) for _, _, exposed in sent)
    assert any(len(exposed.timecodes) > 1 for _, _, exposed in sent), "a rolling shutter mixes lights over the rows"


def test_triggered_frames_show_one_light_each():
    sent, _ = taken(1.0, "camera.trigger=light", "camera.trigger_delay_s=0.002")
    assert len(sent) > 25, "of 50 lights, on a machine that is busy"
    codes = [exposed.timecodes for _, _, exposed in sent]
    assert all(len(each) == 1 for each in codes) and len(set(codes)) == len(codes)
    for _, part, exposed in sent:
        image = cv2.imdecode(np.frombuffer(part.body, np.uint8), cv2.IMREAD_UNCHANGED)
        assert image.any() == bool(exposed.timecodes[0] % 2), "and that is what they show"
