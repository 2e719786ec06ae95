"""Where functions draw, and when."""

import math
from dataclasses import replace

import pytest
import torch
import trimesh
from pydantic import ValidationError
from torch import Tensor
from torch.testing import assert_close

from luxloop.controllers.functions.base_beams import BaseBeamParams, bend_of_course
from luxloop.controllers.functions.objects import GlareFreeParams, MarkerParams, SignParams
from luxloop.controllers.functions.path import Drawing, LaneParams, PathParams, WidthParams, arc, length_at, point
from luxloop.controllers.functions.planner import LightingParams, Planner
from luxloop.controllers.functions.symbol import PrimitiveParams, SymbolFunctionParams
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.controllers.situation import Situation, TrackedObject, fade
from luxloop.world.frames import pose_from_degrees, transform
from luxloop.world.lamps.presets import idealised
from luxloop.world.scene.body import Body, PoseTrack
from luxloop.world.symbols import Still
from tests.controllers.situations import HERE, LAMPS
from tests.refusal import refusal

UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
PERSON = TrackedObject("anna", "pedestrian", pose_from_degrees((20.0, 3.0, 0.0), yaw_deg=90), (0.4, 0.6, 1.8), since_s=1.0, until_s=9.0)


class Ramp:
    def at(self, time_s: float) -> Tensor:
        return torch.full((2, 2), time_s / 10)


def now(*objects: TrackedObject, time_s: float = 2.0, T: Tensor = HERE, **more: object) -> Situation:
    symbols = {"a": Still(torch.ones(4, 4)), "ramp": Ramp()}
    return Situation(time_s, T, LAMPS, objects, symbols=symbols, **more)


def extent(p: Primitives) -> tuple[Tensor, Tensor]:
    corners = p.corners().reshape(-1, 3)
    return corners.amin(0), corners.amax(0)


def test_fades_keep_their_ends():
    assert [fade(t, 0, math.inf, 1, 1) for t in (-1, 0, 0.5, 1, 5)] == [0, 0, 0.5, 1, 1]
    assert fade(0.2, 0, math.inf, 1, 1) + fade(0.8, 0, math.inf, 1, 1) == pytest.approx(1)
    assert [fade(t, -math.inf, 2, 0, 0) for t in (0, 1.9, 2)] == [1, 1, 0]


def test_a_marker_leads_to_the_object_and_ends_before_it():
    (line,) = MarkerParams(near_m=8, gap_m=0.5, width_m=0.3).primitives(now(PERSON))
    assert_close(line.normal[0], UP)
    far = line.origin[0] + line.d1[0] / 2
    way = torch.tensor([20.0, 3.0]).double() / math.hypot(20, 3)
    assert_close((far + line.d2[0])[:2], 8 * way)  # row 0 of its image is far: d2 comes back to the car
    assert far[:2] @ way == pytest.approx(math.hypot(19.7, 2.8) - 0.5)
    assert line.d1[0].norm() == pytest.approx(0.3)
    assert not MarkerParams(near_m=19.5).primitives(now(PERSON))
    assert not MarkerParams().primitives(now(PERSON, time_s=0.5)) and not MarkerParams().primitives(now(PERSON, time_s=9.0))
    assert not MarkerParams(start_s=3.0).primitives(now(PERSON))
    line, around = MarkerParams(surround_m=0.5, surround_u_rel=0.2).primitives(now(PERSON))
    assert line.priority[0] > around.priority[0] and around.d1[0].norm() - line.d1[0].norm() == pytest.approx(1.0)
    (body,) = MarkerParams(target="body", up_to=0.5).primitives(now(PERSON))
    assert [each[2] for each in extent(body)] == pytest.approx([0.0, 0.9], abs=1e-9)
    assert body.normal[0] @ (LAMPS.mean(0) - PERSON.T_world_object[:3, 3]) > 0


@pytest.mark.parametrize(
    ("kind", "given"), [(MarkerParams, {"target": "body"}), (MarkerParams, {"surround_m": 0.5}), (SymbolFunctionParams, {"image": "a"})]
)
def test_while_what_blinks_is_off_it_does_not_darken_the_beam(kind, given):
    blinking = kind(animation={"kind": "blinking", "rate_hz": 1.0}, **given)
    still = kind(**given)
    assert len(blinking.primitives(now(PERSON, time_s=2.4))) == len(still.primitives(now(PERSON, time_s=2.6))) > 0
    assert not blinking.primitives(now(PERSON, time_s=2.6))


@pytest.mark.parametrize("yaw_deg", [0.0, 180.0, 160.0])
def test_a_sign_is_dimmed_in_its_face_that_looks_at_the_car(yaw_deg):
    sign = TrackedObject("stop", "sign", pose_from_degrees((30, -4, 2.0), yaw_deg=yaw_deg), (0.05, 0.8, 0.8))
    (face,) = SignParams(margin_m=0.1).primitives(now(sign))
    assert face.forced.all() and face.normal[0, 0] < -0.9
    assert sorted(v.norm().item() for v in (face.d1[0], face.d2[0])) == pytest.approx([1.0, 1.0])
    assert not SignParams().primitives(now(PERSON))


def test_functions_move_with_the_car():
    T = pose_from_degrees((100, 50, 2), yaw_deg=90)
    turned = PrimitiveParams(x_m=30, z_m=2, roll_deg=20, pitch_deg=-50, yaw_deg=10, width_m=2, length_m=3)
    for function in (SymbolFunctionParams(image="a"), PathParams(control_m=((5, 0), (10, 0))), LaneParams(), WidthParams(), turned):
        for here, there in zip(function.primitives(now()), function.primitives(now(T=T)), strict=True):
            assert_close(transform(T, here.corners()[0].T).T, there.corners()[0])
            assert_close(T[:3, :3] @ here.normal[0], there.normal[0])
            assert_close(-torch.nn.functional.normalize(torch.linalg.cross(here.d1[0], here.d2[0]), dim=0), here.normal[0])
    (here,) = turned.primitives(now())
    assert (here.d1[0].norm().item(), here.d2[0].norm().item()) == pytest.approx((2.0, 3.0))
    assert_close(-torch.linalg.cross(here.d1[0], here.d2[0]) / 6, here.normal[0])


def test_a_symbol_lies_where_it_shall_with_its_far_end_first():
    (p,) = SymbolFunctionParams(image="a", x_m=20, y_m=1, width_m=2, length_m=6).primitives(now())
    assert_close(p.origin[0], torch.tensor([23.0, 2.0, 0.0]).double())
    assert_close(torch.stack([p.d1[0], p.d2[0]]), torch.tensor([[0.0, -2.0, 0], [-6.0, 0, 0]]).double())
    assert_close(p.normal[0], UP)


def test_conditions_exchange_symbols_as_an_object_comes_near():
    """The example of T fig. 7.10."""
    near = {"nearer_than_m": 25.0}
    snow, arrow = SymbolFunctionParams(image="a", unless=near), SymbolFunctionParams(image="a", when=near)
    for x, shows_arrow in ((40.0, False), (20.0, True), (-5.0, False)):
        other = TrackedObject("c", "car", pose_from_degrees((x, 0, 0)), (4, 2, 1.5))
        assert (len(snow.primitives(now(other))), len(arrow.primitives(now(other)))) == (int(not shows_arrow), int(shows_arrow))
    assert snow.primitives(now()) and not arrow.primitives(now())
    (begun,) = SymbolFunctionParams(image="ramp", start_s=1.5).primitives(now(time_s=2.0))
    assert begun.symbols[0].amax().item() == pytest.approx(0.05), "it begins when its function begins"


@pytest.mark.parametrize("value", [0.2, 5.0])
def test_black_leaves_the_base_beam_where_it_is_changed_relatively(value):
    ramp = torch.linspace(0, 1, 5).view(1, 5)
    situation = replace(now(), symbols={"a": Still(ramp)})
    (p,) = SymbolFunctionParams(image="a", quantity="u_rel", value=value).primitives(situation)
    assert_close(p.symbols[0] * p.value[0], (1 + (value - 1) * ramp).double())
    assert p.symbols[0].max() <= 1


def test_an_observer_gets_a_rectangle_of_his_own():
    (p,) = SymbolFunctionParams(image="a", observer={"name": "anna"}).primitives(now(PERSON))
    assert p.observer is not None and p.observer.active.all()
    assert_close(p.observer.eye[0], torch.tensor([20.0, 3.0, 1.5]).double())
    assert_close(p.normal[0], UP)
    assert not SymbolFunctionParams(image="a", observer={"name": "anna"}).primitives(now())
    with refusal("lower the picture"):
        SymbolFunctionParams(image="a", observer={"centre_m": (10, 0, 2.0)}).primitives(now())


CURVE = torch.tensor([[5.0, 0.0], [12.0, 0.0], [16.0, 2.0], [18.0, 6.0]], dtype=torch.float64)


def test_a_path_is_as_large_as_its_band():
    drawing = Drawing(CURVE, 0.5, 0.02)
    image = drawing.band(0.5)
    length = length_at(CURVE, torch.ones(1).double()).item()
    assert image.sum().item() * 0.02**2 == pytest.approx(length * 1.0 + math.pi * 0.25, rel=2e-3)  # a soft edge of 2 cm averages out
    assert not image[0].any() and not image[-1].any() and not image[:, 0].any() and not image[:, -1].any()


def test_a_path_lies_on_the_road_where_its_points_say():
    (p,) = PathParams(control_m=((10, 2), (20, 2)), width_m=1.0, texel_m=0.05).primitives(now())
    image = p.symbols[0].prod(0)  # light where it is opaque
    rows = len(image)
    centre = (p.origin + (p.d1 + p.d2) / 2)[0]
    assert centre[:2].tolist() == pytest.approx([15, 2], abs=0.05)
    lit = image.sum(1).nonzero()[:, 0]
    ahead = p.origin[0, 0] - (lit + 0.5) / rows * p.d2[0].norm()
    assert ahead.min() == pytest.approx(9.5, abs=0.06) and ahead.max() == pytest.approx(20.5, abs=0.06)


@pytest.mark.parametrize("image", [None, "a"])
def test_a_path_leaves_the_base_beam_beside_it(image):
    """An even beam of 0.6: in the bend's rectangle it is taken away in the band only."""
    light = idealised(40, 120)
    ssc = Ssc.prepare(light, default=torch.full((light.n_pixels,), 0.6))
    dark = PathParams(control_m=((12, -1), (16, -1), (18, 2), (26, 2)), width_m=0.5, image=image, value=0.0)
    (band,) = dark.primitives(now())
    (around,) = SymbolFunctionParams(image="a", value=0.0, x_m=19, y_m=0.5, width_m=3.5, length_m=14.5).primitives(now())
    taken, all_taken = (
        float((0.6 - ssc.utilisation(each.to(torch.float32), pose_from_degrees((0.0, 0.6, 0.75))).u).sum()) for each in (band, around)
    )
    assert 0 < taken < 0.4 * all_taken  # of 3.5 m


def test_chevrons_are_bent_along_the_path_and_run():
    """On a straight path a bent image is the image; moved by a pitch it looks the same."""
    line = torch.tensor([[0.0, 0.0], [8.0, 0.0]], dtype=torch.float64)
    drawing = Drawing(line, 1.0, 0.05)
    image = torch.zeros(4, 2, dtype=torch.float64)
    image[0, 0] = 1  # far left
    bent = drawing.bent(image, 2.0, 4.0, 4.0)
    inside = (drawing.along > 3.4) & (drawing.along < 3.6) & (drawing.distance > 0.4) & (drawing.distance < 0.6)
    assert bent[inside].min() > 0.7
    assert not bent[(drawing.along % 4 < 2.0) | (drawing.distance < -0.6)].any()
    assert_close(drawing.bent(image, 2.0, 4.0, 4.0, shift_m=4.0), bent, atol=1e-6, rtol=0)
    moved = drawing.bent(image, 2.0, 4.0, 4.0, shift_m=1.0)
    assert moved[(drawing.along > 4.4) & (drawing.along < 4.6) & (drawing.distance > 0.4) & (drawing.distance < 0.6)].min() > 0.7


@pytest.mark.parametrize("curvature", [0.02, -0.03, 0.125])
def test_a_bent_lane_follows_the_circle(curvature):
    """In a bend of 8 m it ends after a quarter turn, which it would else leave by a metre."""
    control = arc(curvature, 6.0, min(40.0, 6.0 + math.pi / 2 / abs(curvature)))
    points = point(control, torch.linspace(0, 1, 50, dtype=torch.float64))
    centre = torch.tensor([0.0, 1 / curvature], dtype=torch.float64)
    assert_close((points - centre).norm(dim=-1), torch.full((50,), 1 / abs(curvature)).double(), rtol=3e-4, atol=0)
    (bent,) = LaneParams(style="lines", texel_m=0.05).primitives(now(curvature_1_m=curvature))
    p, image = bent, bent.symbols[0].prod(0)
    rows, cols = image.shape
    r, c = (image > 0.5).nonzero().double().T + 0.5
    lit = p.origin[0] + (c / cols)[:, None] * p.d1[0] + (r / rows)[:, None] * p.d2[0]
    offset = (lit[:, :2] - centre).norm(dim=-1) - 1 / abs(curvature)
    assert offset.abs().min() > 1.15 and offset.abs().max() < 1.45  # borders at +-1.3 m, 20 cm wide, and texels of 5 cm
    assert (offset > 0).double().mean() == pytest.approx(0.5 + 0.65 * abs(curvature), abs=0.02)  # the outer one is longer


def test_lines_of_a_lane_are_its_width_apart():
    left, right = LaneParams(style="lines", lane_width_m=3.0, line_width_m=0.2).primitives(now())
    assert extent(left)[1][1] == pytest.approx(1.6) and extent(right)[0][1] == pytest.approx(-1.6)
    left, right = WidthParams(vehicle_width_m=2.0).primitives(now())
    assert extent(left)[1][1] == pytest.approx(1.0) and extent(right)[0][1] == pytest.approx(-1.0)


@pytest.mark.parametrize(
    ("moment", "beam"),
    [
        ({"speed_m_s": 10.0}, "town"),
        ({"speed_m_s": 25.0}, "low"),
        ({"speed_m_s": 25.0, "street_lit": True}, "town"),
        ({"speed_m_s": 36.0}, "motorway"),
        ({"speed_m_s": 36.0, "wet": True}, "adverse"),
    ],
)
def test_the_base_beam_is_chosen_by_situation(moment, beam):
    assert BaseBeamParams(beam="auto").at(now(**moment)).name == beam
    assert BaseBeamParams(beam="high").at(now(**moment)).name == "high"


def test_the_base_beam_bends_into_curves():
    radius, distance = 200.0, 50.0
    angle = bend_of_course(1 / radius, distance)
    chord = 2 * radius * math.sin(distance / radius / 2)
    assert math.hypot(chord * math.cos(angle), chord * math.sin(angle) - radius) == pytest.approx(radius, rel=1e-3)
    params = BaseBeamParams(beam="low", follow_course=True, largest_bend_deg=5, level_deg=1)
    beam = params.at(now(curvature_1_m=-0.02, speed_m_s=20.0))
    ahead = beam.morph.T_headlight_screen[:3, 0].tolist()
    assert math.degrees(math.atan2(ahead[1], ahead[0])) == pytest.approx(-5) and math.degrees(math.asin(-ahead[2])) == pytest.approx(1)


def test_a_perfect_tracker_reports_the_box_of_a_body():
    mesh = trimesh.creation.box((4, 2, 1))
    mesh.apply_translation((1, 0, 0.8))
    track = PoseTrack((0.0, 1.0), torch.stack([HERE, pose_from_degrees((10, 0, 0))]), 0.0, 5.0)
    each = TrackedObject.of(Body("van", mesh, track=track), "car", 1.0)
    assert each.size_m == pytest.approx((4, 2, 1)) and each.until_s == 5.0
    assert_close(each.T_world_object[:3, 3], torch.tensor([11.0, 0.0, 0.3]).double())


@pytest.mark.parametrize(
    ("kind", "given", "words"),
    [
        (LaneParams, {"near_m": 20, "far_m": 20}, "far_m: 20 is not above near_m = 20"),
        (LaneParams, {"start_s": 2, "stop_s": 2}, "stop_s: 2 is not above start_s"),
        (GlareFreeParams, {"nearer_than_m": 20, "farther_than_m": 20}, "nearer_than_m: 20 is not above farther_than_m"),
        (
            GlareFreeParams,
            {"soft_zones": [{"margin_m": 0.9, "u_rel": 0.5}, {"margin_m": 0.4, "u_rel": 0.3}]},
            "soft_zones: margin_m must ascend",
        ),
        (PathParams, {"control_m": [(9, 1), (9, 1), (9, 1)]}, "control_m: all points coincide"),
        (PathParams, {"control_m": [(10, 0), (9e3, 5e3)]}, "control_m: .*raise texel_m"),  # before it takes all memory
        (PrimitiveParams, {"pitch_deg": math.nan}, "pitch_deg"),
        (SymbolFunctionParams, {"image": "a", "x_m": -3}, "x_m"),
        (
            SymbolFunctionParams,
            {"image": "a", "observer": {"name": "anna", "eye_m": (0, 0, 1)}},
            "eye_m: the observer is the object 'anna'",
        ),
    ],
)
def test_what_could_draw_nothing_is_refused(kind, given, words):
    with pytest.raises(ValidationError, match=words):
        kind(**given)


def test_what_is_indicated_acts_with_that_side_and_with_the_hazard_lights():
    symbol = SymbolFunctionParams(image="a", indicated="left")
    shown = {each: bool(symbol.primitives(now(indicator=each))) for each in ("off", "left", "right", "hazard")}
    assert shown == {"off": False, "left": True, "right": False, "hazard": True}
    late = LaneParams(indicated="right", start_s=3.0)
    assert not late.primitives(now(indicator="right")) and late.primitives(now(indicator="right", time_s=3.0))
    assert LaneParams().primitives(now())


def test_a_primitive_on_the_road_is_a_symbol():
    given = {"image": "a", "x_m": 20.0, "y_m": 1.0, "yaw_deg": 30.0, "width_m": 2.0, "length_m": 6.0}
    (one,), (other,) = (kind(**given).primitives(now()) for kind in (PrimitiveParams, SymbolFunctionParams))
    for name in ("origin", "d1", "d2", "normal", "value", "priority"):
        assert_close(getattr(one, name), getattr(other, name))
    assert one.symbols[0].equal(other.symbols[0])


def test_an_upright_primitive_faces_the_car_with_its_first_row_on_top():
    (p,) = PrimitiveParams(x_m=25, y_m=1, z_m=1.5, pitch_deg=-90, width_m=2, length_m=3).primitives(now())
    assert_close(p.origin[0], torch.tensor([25.0, 2.0, 3.0]).double())
    assert_close(torch.stack([p.d1[0], p.d2[0]]), torch.tensor([[0.0, -2.0, 0.0], [0.0, 0.0, -3.0]]).double())
    assert_close(p.normal[0], torch.tensor([-1.0, 0.0, 0.0]).double())


def test_an_upright_primitive_lights_the_directions_in_which_it_is_seen():
    """A wall of light 20 m ahead, 4 m wide and 1 m high, is seen from the lamp at tangents of +-0.1 across and -0.01 +-0.025 up."""
    planner = Planner.prepare(
        {"wall": {"kind": "primitive", "x_m": 20, "z_m": 0.55, "pitch_deg": -90, "width_m": 4, "length_m": 1}},
        LightingParams(base=BaseBeamParams(beam="off")),
    )
    light = idealised(60, 200)
    drawn = planner.plan(now()).for_module("left")
    assert drawn is not None
    u = Ssc.prepare(light, default=torch.zeros(light.n_pixels)).utilisation(drawn, pose_from_degrees((0.0, 0.0, 0.75))).u
    lit = light.light_texture(u) / light.light_texture(torch.ones_like(u))
    up, across = (
        (torch.linspace(a, b, 2 * n + 1)[1::2] - middle).abs()  # of the texels
        for a, b, n, middle in ((light.top, light.bottom, light.rows, -0.01), (light.left, light.right, light.cols, 0.0))
    )
    pixel = 0.002  # tangent of a pixel and a little more, by which an edge is blurred
    assert lit[up < 0.025 - pixel][:, across < 0.1 - pixel].min() > 0.99
    assert lit[up > 0.025 + pixel].max() == lit[:, across > 0.1 + pixel].max() == 0


def test_a_primitive_is_drawn_while_it_is_active():
    params = PrimitiveParams(start_s=1.0, animation={"kind": "blinking", "rate_hz": 1.0})
    assert [len(params.primitives(now(time_s=t))) for t in (0.5, 1.2, 1.7)] == [0, 1, 0]
