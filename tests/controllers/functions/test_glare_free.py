"""Masks hold all of what they mask, seen from every lamp, and leave no light on it."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from luxloop.controllers.functions.object_based import ObjectBasedParams
from luxloop.controllers.functions.objects import PROBE_LX, GlareFreeParams, extend_box
from luxloop.controllers.functions.planner import LightingParams, Planner
from luxloop.controllers.geometry import cuboid
from luxloop.controllers.pixels.primitives import Primitives, concatenate
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.controllers.situation import Situation, TrackedObject
from luxloop.world.frames import inverse, pose_from_degrees, transform
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.presets import idealised, lamp
from tests.controllers.situations import HERE, LAMPS, car, now, surface


def thousandths(most: float) -> st.SearchStrategy[float]:
    return st.integers(0, round(1000 * most)).map(lambda n: n / 1000)


def enters(mask: Primitives, eye: Tensor, points: Tensor) -> Tensor:
    """Which rays from the eye to points `[3, N]` pass a front face, `[N]`: each plane solved by itself."""
    ray = points - eye[:, None]
    entered = torch.zeros(points.shape[1], dtype=torch.bool)
    for p, a, b in zip(mask.origin, mask.d1, mask.d2, strict=True):
        n = torch.linalg.cross(a, b)
        along = n @ ray
        hit = eye[:, None] + ray * ((p - eye) @ n / along) - p[:, None]
        u, v = (hit * a[:, None]).sum(0) / (a @ a), (hit * b[:, None]).sum(0) / (b @ b)
        entered |= (along < 0) & ((p - eye) @ n < 0) & (torch.stack([u, v, 1 - u, 1 - v]).amin(0) >= -1e-9)
    return entered


def test_a_cuboid_has_six_faces_that_look_outward():
    T = pose_from_degrees((10, 3, 1), 10, 20, 30)
    low, high = torch.tensor([-1.0, -2.0, 0.0]).double(), torch.tensor([2.0, 3.0, 4.0]).double()
    origin, d1, d2 = cuboid(T, low, high)
    middle = origin + (d1 + d2) / 2
    normal = torch.linalg.cross(d1, d2)
    assert (((middle - middle.mean(0)) * normal).sum(-1) > 0).all()
    corners = torch.stack([origin, origin + d1, origin + d2, origin + d1 + d2], 1).reshape(-1, 3)
    local = transform(inverse(T), corners.T).T
    assert len(local.round(decimals=6).unique(dim=0)) == 8
    assert_close(torch.stack([local.amin(0), local.amax(0)]), torch.stack([low, high]))
    assert normal.norm(dim=-1).sum().item() == pytest.approx(2 * (3 * 5 + 3 * 4 + 5 * 4))
    assert_close(cuboid(torch.stack([T, HERE]), low, high)[0][0], origin)


@settings(max_examples=40)
@given(x=st.floats(3.5, 90), y=st.floats(-12, 12), yaw_deg=st.floats(-180, 180), margin_m=thousandths(1.5), margin_deg=thousandths(1.0))
def test_the_mask_holds_the_whole_box_seen_from_both_lamps(x, y, yaw_deg, margin_m, margin_deg):
    """Right beside the car too, where a margin would reach around a lamp if it were not cut."""
    each = car(x, y, yaw_deg)
    parts = GlareFreeParams(margin_m=margin_m, margin_deg=margin_deg).primitives(now(each))
    if not parts:
        assert now().distance_m(each) < 0
        return
    mask = parts[0]
    assert mask.forced.all() and mask.weight.isinf().all() and not mask.value.any()
    for eye in LAMPS:
        assert enters(mask, eye, surface(each)).all()


def test_the_foot_stays_lit_before_it_and_the_margin_in_degrees_grows_with_the_distance():
    low, high = extend_box(car(40, 0), 0.5, LAMPS)
    assert low.tolist() == [-2.75, -1.4, 0.0] and high.tolist() == [2.75, 1.4, 2.0]
    params = GlareFreeParams(margin_m=0.0, margin_deg=0.5)
    (mask,) = params.primitives(now(car(60, 0)))
    top = mask.corners()[..., 2].max().item()
    distance = math.hypot(60, 0.6, 0.75)
    assert top == pytest.approx(1.5 + distance * math.tan(math.radians(0.5)))


def test_fades_are_dark_at_once_and_bright_again_slowly():
    params = GlareFreeParams(fade_out_s=1.0)
    each = car(40, 0, since_s=1.0, until_s=5.0)

    def value(time_s: float) -> float:
        parts = params.primitives(now(each, time_s=time_s))
        return float(parts[0].value[0]) if parts else 1.0

    assert [value(t) for t in (0.99, 1.0, 3.0, 5.0)] == [1.0, 0.0, 0.0, 0.0]
    falling = [value(5 + t) for t in (0.1, 0.3, 0.5, 0.7, 0.9)]
    assert falling == sorted(falling) and falling[2] == pytest.approx(0.5) and value(6.0) == 1.0
    slow = GlareFreeParams(fade_in_s=1.0).primitives(now(each, time_s=1.5))[0]
    assert float(slow.value[0]) == pytest.approx(0.5) and slow.weight.isfinite().all()


@pytest.mark.parametrize(
    "fading", [car(20, 0, until_s=0.0), car(48, 3, until_s=0.0), car(20, 0, since_s=0.0)], ids=["before", "beside", "new"]
)
def test_what_fades_yields_to_what_is_dark(fading):
    """It gives light again: in front of a dark object or in one pixel with it, the dark one must win. Zero, not little."""
    dark = car(50, 0)
    masked, free = light_on(now(fading, dark, time_s=0.2), COARSE, GlareFreeParams(fade_in_s=0.6), surface(dark))
    assert free.max() > 100 and masked.max() == 0


def test_soft_zones_are_nested_and_the_mask_lies_on_top():
    zones = [{"margin_m": 0.5, "u_rel": 0.3}, {"margin_m": 1.0, "u_rel": 0.6}]
    mask, inner, outer = GlareFreeParams(soft_zones=zones).primitives(now(car(40, 0)))
    assert mask.priority[0] > inner.priority[0] > outer.priority[0]
    assert inner.value[0] == pytest.approx(0.3) and outer.value[0] == pytest.approx(0.6)
    assert not inner.weight.isinf().any()
    assert outer.corners()[..., 2].max() > inner.corners()[..., 2].max() > mask.corners()[..., 2].max()


def test_only_the_classes_and_distances_meant_are_masked():
    person = TrackedObject("p", "pedestrian", pose_from_degrees((20, 2, 0)), (0.4, 0.5, 1.7))
    assert not GlareFreeParams().primitives(now(person, car(-10, 0), car(300, 0)))
    assert GlareFreeParams(categories=("pedestrian",)).primitives(now(person))
    assert not GlareFreeParams(names=("other",)).primitives(now(car(20, 0)))


FINE, COARSE = idealised(60, 200), lamp("hd84").finest.headlight


def light_on(situation: Situation, light: Headlight, params: GlareFreeParams, points: Tensor) -> tuple[Tensor, Tensor]:
    """Intensity in cd towards points `[3, N]` of each lamp, with and without the function, on a full beam."""
    full = torch.ones(light.n_pixels)
    ssc = Ssc.prepare(light, default=full)
    scene = concatenate(*params.primitives(situation)).to(torch.float32)
    masked, free = [], []
    for position in LAMPS.tolist():
        T = pose_from_degrees(tuple(position))
        local = transform(inverse(T), points).float()
        masked.append(light.intensity(light.light_texture(ssc.utilisation(scene, T).u), local))
        free.append(light.intensity(light.light_texture(full), local))
    return torch.stack(masked), torch.stack(free)


@pytest.mark.parametrize("light", [FINE, COARSE], ids=["fine", "coarse"])
@pytest.mark.parametrize(("x", "y"), [(25.0, 2.5), (60.0, -2.0), (12.0, 0.4)])
@pytest.mark.parametrize("margin", [0.0, 0.2])
def test_no_light_gets_to_the_box(light, x, y, margin):
    """Zero, not little: edges and corners included, though texels beside the box are lit and are interpolated with."""
    each = car(x, y, yaw_deg=170.0)
    masked, free = light_on(now(each), light, GlareFreeParams(margin_m=margin, margin_deg=margin), surface(each))
    assert free.max() > 100
    assert masked.max() == 0
    aside = 3 + 0.1 * x
    beside = torch.tensor([[x, x], [y + aside, y - aside], [0.5, 0.5]], dtype=torch.float64)
    assert_close(*light_on(now(each), light, GlareFreeParams(), beside))


@pytest.mark.parametrize(("confidence", "share"), [(1.0, 0.0), (0.85, 0.5), (0.3, 1.0)])
def test_who_is_not_found_for_sure_gets_light_to_be_found_in(confidence, share):
    """The share of PROBE_LX from each lamp that confidence lacks, and with pixels as large as these at most 1.6 times as much."""
    each = car(25.0, 2.5, confidence=confidence)
    points = surface(each)
    masked, _ = light_on(now(each), COARSE, GlareFreeParams(), points)
    lx = masked / (points[:, None] - LAMPS.T[..., None]).square().sum(0).float()
    assert share * PROBE_LX <= float(lx.max()) <= 1.6 * share * PROBE_LX


@settings(max_examples=30)
@given(x=st.floats(8, 60), y=st.floats(-6, 6), behind_m=st.floats(3, 30), aside=st.floats(-0.9, 0.9))
def test_a_tracked_person_behind_a_mask_is_never_without_light(x, y, behind_m, aside):
    """The mask lets 0.3 lx through at the car, so less where the person is; all of it, since a mask of 0 lx wins over all light."""
    driver = car(x, y)
    at = (x + behind_m) / x
    found = TrackedObject("p", "pedestrian", pose_from_degrees((at * x, at * (y + aside), 0.0)), (0.4, 0.5, 1.7), confidence=0.99)
    (mask,) = GlareFreeParams().primitives(now(driver, found))
    assert_close(
        mask.value, torch.full_like(mask.value, PROBE_LX * ((driver.T_world_object[:3, 3] - LAMPS).norm(dim=1).amin() - 2.25) ** 2)
    )
    far = replace(found, T_world_object=pose_from_degrees((at * x, at * y + at * x, 0.0)))
    for other in (replace(found, confidence=1.0), replace(found, until_s=0.0), replace(found, category="cyclist"), far):
        assert (GlareFreeParams().primitives(now(driver, other))[0].value == 0).all()


def test_a_mask_yields_to_the_light_on_someone_nearer_and_covers_someone_farther():
    person = TrackedObject("p", "pedestrian", pose_from_degrees((30.0, 1.0, 0.0)), (0.4, 0.5, 1.7))
    function = ObjectBasedParams(categories=("pedestrian",))
    for x, covers in ((15.0, True), (45.0, False)):
        situation = now(person, car(x, 1.0))
        (mask,) = GlareFreeParams().primitives(situation)
        core = function.adapted(function.start(), situation)[1]
        assert core.forced.all() and bool((mask.priority > core.priority).all()) == covers


def test_the_guard_leaves_whom_object_light_lights_to_it():
    """Else it would take the light with which the detector finds them, and that of everybody beside them."""
    rider = TrackedObject("r", "cyclist", pose_from_degrees((20.0, 3.0, 0.0)), (0.4, 0.5, 1.7))
    tables = {"guard": {"kind": "glare_free"}, "light": {"kind": "object_based", "categories": ["cyclist"]}}
    planner = Planner.prepare(tables, LightingParams())
    ambient = Planner.prepare({**tables, "light": {**tables["light"], "method": "ambient"}}, LightingParams())
    assert ambient.draw(now(rider), ambient.start())["guard"]
    for each, masks in ((rider, 0), (replace(rider, until_s=0.0), 1), (car(20.0, 3.0), 1)):
        assert len(planner.draw(now(each), planner.start())["guard"]) == masks


def test_light_far_beside_the_box_stays():
    each = car(40.0, 0.0)
    beside = torch.tensor([[40.0, 40.0], [4.0, -4.0], [0.5, 0.5]], dtype=torch.float64)
    masked, free = light_on(now(each), FINE, GlareFreeParams(), beside)
    assert_close(masked, free)
