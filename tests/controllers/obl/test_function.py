"""The function on objects: what it lights, what it leaves dark, what it remembers."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from torch import Tensor

from luxloop.controllers.functions.object_based import (
    CELLS,
    NEAREST_M,
    Apparent,
    ObjectBasedParams,
    ObjectBasedState,
    ObjectLightParams,
    frontal,
)
from luxloop.controllers.functions.object_loop import Ambient
from luxloop.controllers.functions.objects import GlareFreeParams
from luxloop.controllers.pixels.pixel_major import MrpcParams
from luxloop.controllers.pixels.primitives import concatenate
from luxloop.controllers.pixels.secondary import PotentialLight, SecondaryRays
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.controllers.situation import Situation, TrackedObject
from luxloop.perception.tracking import LINGER_S
from luxloop.world.frames import inverse, pose_from_degrees, transform
from luxloop.world.lamps.presets import lamp
from tests.controllers.situations import HERE, car, surface

PLACES = [pose_from_degrees((0.0, y, 0.65)) for y in (0.6, -0.6)]
LAMPS = torch.stack([T[:3, 3] for T in PLACES])
CONSTANT = ObjectBasedParams(method="constant", setpoint_lx=10.0)
DARK = ObjectBasedParams(method="constant", setpoint_lx=10.0, light={"dark_lx": 0.0})


def person(name: str = "person", x: float = 20.0, y: float = 1.0, **what: float) -> TrackedObject:
    return TrackedObject(name, "pedestrian", pose_from_degrees((x, y, 0.0)), (0.4, 0.6, 1.7), **what)


def now(*objects: TrackedObject, time_s: float = 0.0) -> Situation:
    return Situation(time_s, HERE, LAMPS, objects)


@pytest.fixture(scope="module")
def shining():  # type: ignore[no-untyped-def]
    """lx of both lamps together at points `[3, N]`, on a plane that faces each; share: of full light, below the function."""
    light = lamp("ssl-hd-lores").modules[0].headlight
    ssc = Ssc.prepare(light, MrpcParams(a_d=1.0))
    lights = tuple((name, PotentialLight.of(light, T)) for name, T in zip(("left lores", "right lores"), PLACES, strict=True))

    def lx(function: ObjectBasedParams, situation: Situation, points: Tensor, share: float = 0.0) -> Tensor:
        scene = concatenate(*function.adapted(function.start(), situation)).to(torch.float32)
        total = torch.zeros(points.shape[1])
        for k, T in enumerate(PLACES):
            u = ssc.over(torch.full((light.n_pixels,), share)).utilisation(scene, T, SecondaryRays(lights, k)).u
            local = transform(inverse(T), points).float()
            total += light.intensity(light.light_texture(u), local) / local.square().sum(0)
        return total

    return lx


@pytest.mark.parametrize("x", [12.0, 20.0, 30.0])
def test_the_body_gets_the_setpoint_and_the_head_none(shining, x):  # type: ignore[no-untyped-def]
    """Over a beam of full light. Pixels are blurred by 0.4 deg, so that the body is darker right below the head."""
    each, blurred = person(x=x), x * math.tan(math.radians(0.9))
    front = torch.tensor([[x - 0.2] * 3, [0.85, 1.0, 1.15], [0.3, 0.5, 0.6]], dtype=torch.float64)
    assert blurred < 0.5
    torch.testing.assert_close(shining(CONSTANT, now(each), front), torch.full((3,), 10.0), rtol=0.08, atol=0)
    assert shining(DARK, now(each), surface(each, 0.85, 1.0), share=1.0).max() == 0


def test_who_stands_before_a_windscreen_is_lit_and_it_stays_dark_beside(shining):  # type: ignore[no-untyped-def]
    """Its torso is before a windscreen 20 m behind; pixels are blurred by 0.4 deg, 0.1 m there, and the core is 0.3 m wide."""
    near, far = person(x=15.0), car(35.0, 1.0)
    torso = torch.tensor([[14.8] * 3, [1.0] * 3, [0.9, 1.0, 1.1]], dtype=torch.float64)
    lit = shining(CONSTANT, now(near), torso)
    torch.testing.assert_close(shining(CONSTANT, now(far, near), torso), lit, rtol=0.2, atol=0)
    beside = surface(far, 1 - ObjectLightParams().dark["car"], 1.0)
    beside = beside[:, (beside[1] / beside[0] - 1 / 15).abs() > 0.03]
    assert beside.shape[1] and shining(CONSTANT, now(far, near), beside, share=1.0).max() < 1
    gone = replace(near, score=math.nan)  # nobody may stand there any more
    assert shining(CONSTANT, now(far, gone), surface(far, 0.7, 1.0), share=1.0).max() < 1


def test_light_on_a_deer_leaves_the_head_behind_its_back_dark(shining):  # type: ignore[no-untyped-def]
    """It carries its head beside its body, and the air above its back hides nobody."""
    deer = TrackedObject("deer", "animal", pose_from_degrees((8.2, -0.7, 0.0), yaw_deg=90), (1.8, 0.84, 1.3))
    far = person(x=11.7, y=-0.6)
    assert shining(CONSTANT, now(deer, far), surface(far, 0.85, 1.0)).max() < 1
    assert shining(CONSTANT, now(deer), surface(far, 0.85, 1.0)).max() > 2


@settings(max_examples=15)
@given(x=st.floats(8, 60), y=st.floats(-6, 6), kind=st.sampled_from(["car", "person"]))
def test_heads_and_windscreens_stay_dark_wherever_the_object_is(shining, x, y, kind):  # type: ignore[no-untyped-def]
    """Over a beam of full light, all around the upper part of the box: `dark_lx`, or zero, not little, where that is asked for."""
    each = car(x, y) if kind == "car" else person(x=x, y=y)
    eyes = surface(each, 1 - 0.8 * ObjectLightParams().dark[each.category], 1.0)  # the rest is for the pixels' blur
    assert shining(DARK, now(each), eyes, share=1.0).max() == 0
    assert shining(CONSTANT, now(each), eyes, share=1.0).max() < 1


def test_a_mask_beats_the_light_of_an_object_beside_it(shining):  # type: ignore[no-untyped-def]
    """A child stands before someone's chest, and someone behind a car."""
    child = TrackedObject("child", "pedestrian", pose_from_degrees((20.0, 1.0, 0.0)), (0.3, 0.5, 1.1))
    for objects in ((child, person(x=22.0)), (car(25, 1), person(x=29.0, y=1.5))):
        for each in objects:
            dark = 1 - ObjectLightParams().dark[each.category]
            assert shining(DARK, now(*objects), surface(each, dark, 1.0)).max() == 0


@given(x=st.floats(4, 80), y=st.floats(-8, 8), yaw=st.floats(-180, 180))
def test_the_rectangle_covers_the_box_seen_from_every_lamp(x, y, yaw):
    each = replace(car(0.0, 0.0), T_world_object=pose_from_degrees((x, y, 0.0), yaw_deg=yaw))
    low, high = torch.tensor([-2.25, -0.9, 0.0]), torch.tensor([2.25, 0.9, 1.5])
    place = frontal(each.T_world_object, low, high, LAMPS, 0.0, 0.0)
    points = surface(each, 0.0, 1.0)
    ahead = -(place.normal @ (points - LAMPS.mean(0)[:, None])) if place else points[0]
    assert (place is None) <= bool(ahead.amin() < NEAREST_M + 2)
    if place is None:
        return
    for eye in LAMPS:
        ray = points - eye[:, None]
        hit = eye[:, None] + ray * ((place.origin - eye) @ place.normal / (place.normal @ ray)) - place.origin[:, None]
        u, v = place.d1 @ hit / place.d1.square().sum(), place.d2 @ hit / place.d2.square().sum()
        assert torch.stack([u, v, 1 - u, 1 - v]).amin() >= -1e-6
        assert (ray.norm(dim=0) - (hit + place.origin[:, None] - eye[:, None]).norm(dim=0)).amin() > -1e-6  # before the box


@pytest.mark.parametrize(
    ("params", "given", "words"),
    [
        (ObjectBasedParams, {"fade_out_s": 2 * LINGER_S}, "less than or equal to 2"),  # for longer than trackers tell of it
        (GlareFreeParams, {"fade_out_s": 2 * LINGER_S}, "less than or equal to 2"),
        (ObjectBasedParams, {"setpoints_lx": {"pedestrian": -1}}, "setpoints_lx.pedestrian\n.*greater than or equal to 0"),
        (ObjectLightParams, {"dark": {"car": 2.0}}, "dark.car\n.*less than or equal to 1"),
        (ObjectLightParams, {"period_m": 0.02}, "greater than or equal to 0.05"),
    ],
)
def test_bad_values_are_refused_by_name(params, given, words):
    with pytest.raises(ValidationError, match=words):
        params(**given)


def test_setpoints_follow_the_class():
    function = ObjectBasedParams(method="class", setpoints_lx={"pedestrian": 7.0}, setpoint_lx=2.0)
    values = [part.value.item() for part in function.adapted(function.start(), now(person(), car(30.0, 3.0)))]
    dark = function.light.dark_lx
    assert values == [7.0, 7.0, dark, 2.0, 2.0, dark]  # each on the whole and on its core
    assert function.base_share(function.start()) == function.share
    assert function.step(function.start(), now(person())) == function.start()


@pytest.mark.parametrize(("confidence", "parts"), [(0.9, 1), (0.5, 2)])
def test_who_may_be_no_animal_has_a_dark_head(confidence, parts):
    deer = replace(person(), category="animal", confidence=confidence)
    assert len(CONSTANT.adapted(CONSTANT.start(), now(deer))) == parts


def test_structure_is_light_and_dark_in_cells_of_half_a_period():
    for pattern, dark in (("stripes", 0.5), ("checks", 0.5)):
        light = ObjectLightParams(pattern=pattern, period_m=0.4, margin_m=0.0)
        lit = light.on(person(), LAMPS, 10.0, 0, 0, ())[0]
        image = lit.image_of(0)
        assert set(image.unique().tolist()) == {0.0, 1.0} and abs(image.mean() - dark) < 0.2
        cell = lit.d1.norm() / image.shape[1] * 16
        assert cell == pytest.approx(0.2, rel=0.2)
    rows = ObjectLightParams(pattern="stripes").on(person(), LAMPS, 10.0, 0, 0, ())[0].image_of(0)
    assert (rows == rows[0]).all() and len(rows) == CELLS  # one row of them, however high the object is


def test_a_new_object_is_lit_at_once_and_a_lost_one_fades():
    function = ObjectBasedParams()
    start, seen = function.start(), now(person(since_s=0.0, score=0.4))
    state = function.step(start, seen)
    assert start == ObjectBasedState(Ambient(1.0)) and function.base_share(start) == 1.0 and start != state == function.step(start, seen)
    assert function.adapted(state, now(person(since_s=0.0)))[0].value.item() == 20.0
    fading = []
    for k in range(30):
        situation = now(person(since_s=0.0, until_s=1.0), time_s=0.8 + k / 30)
        parts = function.adapted(state, situation)
        fading.append(parts[0].value.item() if parts else 0.0)
        state = function.step(state, situation)
    assert fading[0] == 20.0 and fading == sorted(fading, reverse=True) and fading[-1] == 0.0
    assert not function.step(state, now(time_s=3.0)).loops


@pytest.mark.parametrize(
    ("y", "until_s", "score", "goes_on"), [(1.2, 2.5, 0.7, True), (1.2, math.inf, math.nan, True), (2.5, 2.5, 0.7, False)]
)
def test_a_new_track_goes_on_with_the_light_of_one_that_is_missed_there(y, until_s, score, goes_on):
    """Whether that is lost, or just not found any more; one who comes to stand beside it is somebody else, and gets all light."""
    function = ObjectBasedParams()
    state = function.start()
    for k in range(60):
        state = function.step(state, now(person(score=0.7), time_s=k / 30))
    lx = state.loops["person"].lx
    assert lx < 3
    missed = person(until_s=until_s, score=math.nan)
    state = function.step(state, now(missed, person("another", y=y, since_s=2.6, score=score), time_s=2.6))
    assert state.loops["another"].lx == (lx if goes_on else 20.0)
    both = now(person(score=0.7), person("second", y=1.2, since_s=2.6, score=0.7), time_s=2.6)
    assert function.step(state, both).loops["second"].lx == 20.0


def test_neighbours_that_share_their_light_settle_together():
    """Each sees a third of the other's light too; none ends doubtful, and both stay where they settle."""
    function = ObjectBasedParams()
    names, knees = ("left", "right"), (3.0, 8.0)
    state = function.start()
    history = []
    for k in range(240):
        lx = [state.loops[name].lx if name in state.loops else 1.0 for name in names]
        reached = [lx[0] + lx[1] / 3, lx[1] + lx[0] / 3]
        scores = [min(0.7, 0.7 + 0.12 * math.log2(e / knee)) for e, knee in zip(reached, knees, strict=True)]
        people = [person(name, y=y, score=score) for name, y, score in zip(names, (-1.0, 1.0), scores, strict=True)]
        state = function.step(state, now(*people, time_s=k / 30))
        history.append((tuple(loop.lx for loop in state.loops.values()), all(loop.settled for loop in state.loops.values())))
    assert all(settled for _, settled in history[60:])
    assert len({lx for lx, _ in history[60:]}) == 1
    assert min(scores) >= 0.65
    assert state.share == function.ambient.least


@pytest.mark.parametrize(("bright", "dim", "rises"), [(0.7, 0.4, True), (0.7, 0.7, False), (0.25, 0.1, False)])
def test_it_is_the_lost_object_that_brings_light_back(bright, dim, rises):
    """One that gets the brightest light and is lost in spite of it; not one that its own light may help, nor one that was never sure."""
    function = ObjectBasedParams()
    state = function.step(function.start(), now(person()))
    for k in range(60):
        score = bright if state.loops["person"].lx > 15 else dim
        state = function.step(state, now(person(score=score), time_s=k / 30))
    low = state.share
    for k in range(60, 70):
        state = function.step(state, now(person(score=math.nan), time_s=k / 30))
    assert (state.share > low) == rises


def test_the_base_beam_alone_keeps_the_least_share_in_which_objects_are_found():
    function = ObjectBasedParams(method="ambient")
    state, shares = function.start(), []
    for k in range(70):  # less than its patience
        seen = now(person(score=0.9 if state.share > 0.3 else math.nan), time_s=k / 30)
        assert function.adapted(state, seen) == ()
        state = function.step(state, seen)
        shares.append(state.share)
    assert min(shares) == 0.25 and shares[-40:] == [0.5] * 40, "halved once too often, then doubled"


AHEAD = torch.tensor([[2.0, 0.6, 0.65], [2.0, -0.6, 0.65]], dtype=torch.float64)


def apparent(x: float, y: float, height: float = 1.7, width: float = 0.6) -> Apparent:
    return Apparent.of(TrackedObject("person", "pedestrian", pose_from_degrees((2 + x, y, 0.0)), (0.4, width, height)), AHEAD)


@given(x=st.floats(5, 80), y=st.floats(-10, 10), error=st.floats(0.4, 2.5))
def test_an_error_of_the_distance_changes_nothing(x, y, error):
    """A box that fills the same part of the image is larger the farther away it is taken to be."""
    near, far = apparent(x, y), apparent(error * x, error * y, error * 1.7, error * 0.6)
    for name in ("bearing_rad", "width_rad", "height_rad"):
        assert getattr(far, name) == pytest.approx(getattr(near, name), rel=1e-9)
    assert near.same(far) and far.same(near)


@pytest.mark.parametrize(
    ("other", "same"), [((20, 1.5), True), ((20, 1.7), False), ((28, 1.4), True), ((34, 1.7), False), ((13, 0.65), False)]
)
def test_who_stands_beside_or_far_behind_is_somebody_else(other, same):
    assert apparent(20, 1.0).same(apparent(*other)) == same


@pytest.mark.parametrize(("x", "height"), [(9.0, 1.7), (11.0, 1.9)])
def test_a_head_at_the_upper_edge_of_the_light_gets_no_more_than_others(shining, x, height):
    """No pixel above takes a share there: without edge darkening (T 7.5.2) it would get 1.6 times as much. 5 % are the pixels' steps."""
    each = replace(person(x=x), size_m=(0.4, 0.6, height))
    assert 0.9 < shining(CONSTANT, now(each), surface(each, 0.8, 1.0)).max() / CONSTANT.light.dark_lx < 1.05


def test_what_stands_beside_the_lamps_is_left_alone():
    assert not CONSTANT.adapted(CONSTANT.start(), now(person(x=1.0, y=1.2)))
