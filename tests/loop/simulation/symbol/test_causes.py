"""Causes of an IoU: what is recorded of body and road, and the symbol drawn for the true ones."""

import numpy as np
import pyarrow as pa
import pytest
import torch

from luxloop import load
from luxloop.loop.recording.manifest import table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.recording.summary import column
from luxloop.loop.simulation.columns import MOTION
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import simulation_of

SMALL = [f"headlight.model={SMALL_LAMP}", "camera.width_px=320", "camera.height_px=240", "camera.oversampling=2", "judge_causes=true"]
CAUSES = ("iou_open", "iou_true_pose", "iou_true_road", "iou_true")
NODS = "vehicle={course=[{speed_m_s=10}], oscillation={pitch_deg=0.4, rate_hz=1.2}}"
UNIT = "sensors={fitted=['wheels', 'gyro', 'attitude']"


def recorded(name: str, *changes: str, steps: int) -> pa.Table:
    simulation = simulation_of(load(name, [*SMALL, *changes], steps=steps))
    return table_of([row(each) for each in simulation.evaluations()], schema(simulation))


def of_symbol(table: pa.Table, *names: str) -> list[np.ndarray]:
    return [column(table, f"functions.symbol.{name}") for name in names]


def test_a_controller_that_knows_the_true_road_gains_nothing_by_it():
    road = "{kind='iso8608', roughness_class='D', seed=15}"
    table = recorded("flat", f"road={road}", f"functions.symbol.controller={{name='feedforward', road={road}}}", steps=1)
    true_m, believed_m = of_symbol(table, "road_true_m", "road_believed_m")
    assert abs(true_m) > 0.005 and believed_m == pytest.approx(true_m, abs=1e-3)  # heights are known every 0.1 m on the plane
    iou, iou_open, *others = of_symbol(table, "iou", *CAUSES)
    assert np.array_equal(others, [iou] * 3) and iou > iou_open
    assert not any(of_symbol(table, *MOTION))


def test_the_open_loop_beside_is_that_of_a_run_without_control():
    held, opened = (recorded("driving", f"functions.symbol.controller={{name='{name}'}}", steps=4) for name in ("luxloop", "open"))
    assert np.array_equal(*(of_symbol(table, key)[0] for table, key in ((held, "iou_open"), (opened, "iou"))))
    assert np.array_equal(*(of_symbol(table, "iou_true")[0] for table in (held, opened)))
    assert all(np.isnan(each).all() for each in of_symbol(opened, "iou_true_pose", "iou_true_road", "road_believed_m"))


def test_a_body_that_is_measured_late_costs_what_its_true_pose_gives_back():
    table = recorded("driving", "road.kind='flat'", NODS, UNIT + ", gyro.noise_deg_s=0, attitude.delay_s=0.1}", steps=12)
    true, measured = (column(table, f"body.{each}.pitch_deg") for each in ("true", "measured"))
    assert measured[3:] == pytest.approx(true[:-3], abs=1e-4)  # 0.1 s are three steps
    iou, pose, both = (each.mean() for each in of_symbol(table, "iou", "iou_true_pose", "iou_true"))
    assert iou < pose < both + 0.02
    error, motion = of_symbol(table, "centroid_error_x_percent", "centroid_motion_x_percent")
    assert np.abs(error - motion).mean() < np.abs(error).mean()


def test_light_that_follows_the_body_between_frames_stays_where_it_was_in_the_frame():
    fast = {"rate_hz": 240, "delay_s": 0.005}
    sensors = f"sensors={{wheels={fast}, gyro={fast}, accelerometer={fast}, suspension={fast}}}".replace(":", " =").replace("'", "")
    held, drawn = (
        recorded("driving", "road.kind='flat'", NODS, "camera.exposure_s=0.004", sensors, *changes, steps=10)
        for changes in ([], ["headlight.rate_hz=240"])
    )
    (iou, end), (same, followed) = (of_symbol(table, "iou", "iou_end") for table in (held, drawn))
    assert np.array_equal(iou, same), "the frames and what is learnt from them are the same"
    # from the first frame on; in 4 ms, the time of a drawing, the body turns by a quarter of what it does in 17 ms
    assert (same - followed)[1:].mean() < 0.3 * (iou - end)[1:].mean()


def test_late_light_is_drawn_for_the_samples_that_were_there_in_time():
    fast = "{rate_hz=100, delay_s=0.01}"
    given = [
        f"sensors={{wheels={fast}, gyro={fast}, accelerometer={fast}, suspension={fast}}}",
        "headlight.delay_s=0.02",
        "headlight.rate_hz=100",
        *SMALL,
    ]
    simulation = simulation_of(load("driving", [*given, "camera.exposure_s=0.004"], steps=4))
    *_, result = simulation.run()
    assert result.time_s == pytest.approx(0.1)
    assert result.sense.ego.attitude_s == pytest.approx(0.07) and result.reception.samples[-1].measured_s == pytest.approx(0.12)
    _, alone = simulation.step(simulation.start(3))
    assert alone.time_s == result.time_s and alone.sense.ego.attitude_s == result.sense.ego.attitude_s, "without the steps before, too"
    first, second, *_ = result.exposures
    assert not torch.equal(first.lights[0].u, second.lights[0].u), "a sample of 0.08 s is there when the second is drawn, at 0.108 s"


def test_only_the_first_drawing_of_a_frame_is_in_it():
    simulation = simulation_of(load("driving", [*SMALL, "headlight.rate_hz=100", "camera.exposure_s=0.004", "off_share=0.2"]))
    _, result = simulation.step(simulation.start())
    assert [each.frame for each in result.exposures] == [True, False, False, True], "0.8 and 0.2 of 33 ms are 2.7 and 0.7 drawings"
    assert [each.number for each in result.reception.frames] == [0, 3]
    assert [each.duration_s for each in result.exposures] == pytest.approx([0.8 / 90] * 3 + [0.2 / 30])
    assert [each.start_s for each in result.exposures] == pytest.approx([0, 0.8 / 90, 1.6 / 90, 0.8 / 30])
    assert [list(each.projections) for each in result.exposures] == [["symbol"]] * 3 + [[]]


def test_nothing_is_drawn_anew_without_being_asked():
    assert not any("iou_true" in name or name.endswith("iou_open") for name in schema(simulation_of(load("driving", SMALL[:-1]))).names)
