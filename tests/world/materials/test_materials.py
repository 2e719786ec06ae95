"""Materials in pictures: finishes, water, beads, and spots on the road."""

import pytest
import torch
from pydantic import ValidationError
from torch import Tensor
from torch.nn.functional import normalize
from torch.testing import assert_close

from luxloop.world.frames import pose_from_degrees
from luxloop.world.lamps.presets import idealised
from luxloop.world.light.illumination import lit_surface, luminance
from luxloop.world.materials.brdf import luminance_factor
from luxloop.world.materials.library import MATERIALS, WET, RoadSurfaceParams, SpotParams, SpottedTexture
from luxloop.world.rendering.gbuffer import GBuffer, flat_road
from luxloop.world.scene.body import Body
from luxloop.world.traffic.objects import BoxParams
from tests.world.grids import camera, flat, see

LAMP = idealised(20, 32, intensity_cd=30_000.0)
T_LEFT = pose_from_degrees((0.0, 0.6, 0.75))
ALL_ON = torch.ones(LAMP.n_pixels)


def board(**keys) -> Body:
    """A board across the road."""
    return BoxParams(**{"name": "board", "size_m": (0.1, 1, 1), "albedo": 0.4, "track": [{"position_m": (20, 0.3, 0)}]} | keys).build()


def road(**keys) -> Body:
    surface = RoadSurfaceParams(**keys)
    return Body("road", flat(), surface.albedo, surface.texture(), smooth=True)


def shown(seen: GBuffer) -> Tensor:
    """Luminance of the G-buffer's image in the left lamp's light."""
    lit = lit_surface(seen, LAMP, T_LEFT)
    image = torch.zeros(seen.albedo.numel())
    image[lit.index] = luminance(lit, LAMP.light_texture(ALL_ON))
    return image.view(seen.albedo.shape)


def test_a_lambertian_scene_carries_no_finish():
    seen = see(road(markings=True), board())
    assert seen.finish is None
    lit = lit_surface(seen, LAMP, T_LEFT)
    assert torch.equal(lit.luminance_factor, seen.albedo.flatten()[lit.index])


def test_a_sign_shines_back_as_its_brdf_says_and_nothing_else_changes():
    plain, sign = see(road(), board()), see(road(), board(material="retroreflective_sign"))
    was, now = shown(plain), shown(sign)
    board_pixels = plain.object_id == 1
    assert torch.equal(was[~board_pixels], now[~board_pixels])
    lit = board_pixels & (was > 0)
    position, normal = sign.position[:, lit].double(), sign.normal[:, lit].double()
    to_lamp, to_eye = (normalize(origin[:, None] - position, dim=0) for origin in (T_LEFT[:3, 3], camera().origin))
    factor = luminance_factor(MATERIALS["retroreflective_sign"], torch.full_like(position[0], 0.4), normal, to_lamp, to_eye)
    # directions in float32 against a lobe 1.2 deg wide
    assert_close(now[lit] / was[lit], (factor / 0.4).float(), rtol=1e-3, atol=0)
    # the eye is 0.7 deg to the side and 2 deg above the lamp
    assert 20 < (now[lit] / was[lit]).median() < 200


def test_water_darkens_the_road_and_drowns_the_beads():
    dry, wet = road(markings=True, beads=True, grain=0.0).texture, road(markings=True, beads=True, grain=0.0, wet=1.0).texture
    assert_close(wet.albedo, WET.darken(dry.albedo))
    assert [material.retro > 0 for material in dry.materials] == [False, True]
    assert [material.retro > 0 for material in wet.materials] == [False, False]
    own = shown(see(road(wet=1.0))) / shown(see(road()))
    assert own.nanmean() < 0.6


def test_the_assumed_road_is_as_wet_as_the_real_one():
    surface = RoadSurfaceParams(wet=0.7, grain=0.0)
    assumed, real = flat_road(camera(), surface.seen_albedo, material=surface.ground), see(road(wet=0.7, grain=0.0))
    both = (assumed.object_id == 0) & (real.object_id == 0) & (assumed.position[0] < 60)
    # positions in float32 from two computations
    assert_close(shown(assumed)[both], shown(real)[both], rtol=1e-3, atol=1e-5)
    assert shown(assumed).max() > 0.1
    dry = flat_road(camera(), RoadSurfaceParams().seen_albedo, material=RoadSurfaceParams().ground)
    assert dry.finish is None and torch.equal(dry.albedo, flat_road(camera(), 0.2).albedo)


def test_an_unknown_material_is_refused_with_those_there_are():
    with pytest.raises(ValidationError, match="retroreflective_sign"):
        board(material="sign")


DRY = RoadSurfaceParams(seed=3)


def spotted(*spots: SpotParams, surface: RoadSurfaceParams = DRY) -> SpottedTexture:
    return SpottedTexture(surface, spots)


def cells(x_m: tuple[float, float], y_m: tuple[float, float], step_m: float = 0.01) -> tuple[torch.Tensor, torch.Tensor]:
    """Centres of cells of a rectangle of the road."""
    x, y = (torch.arange(low + step_m / 2, high, step_m, dtype=torch.float64) for low, high in (x_m, y_m))
    return x[:, None].expand(-1, len(y)), y.expand(len(x), -1)


@pytest.mark.parametrize(("shape", "area_m2"), [("rectangle", 6.0), ("ellipse", 6.0 * torch.pi / 4)])
def test_a_turned_spot_covers_its_area(shape, area_m2):
    spot = SpotParams(shape=shape, x_m=17, y_m=1, length_m=4.0, width_m=1.5, yaw_deg=30)
    x, y = cells((13, 21), (-3, 5))
    there = spot.covers(x, y)
    # cells of 1 cm along an outline of at most 11 m: half of them may err, evenly to both sides
    assert float(there.sum()) * 1e-4 == pytest.approx(area_m2, rel=2e-3)
    assert float(x[there].mean()) == pytest.approx(17, abs=5e-3) and float(y[there].mean()) == pytest.approx(1, abs=5e-3)
    ahead_on_the_left = torch.tensor([17 + 1.9 * 0.866]), torch.tensor([1 + 1.9 * 0.5])
    assert spot.covers(*ahead_on_the_left).all()


def test_a_puddle_is_what_a_wet_road_is():
    texture, wet = spotted(SpotParams(x_m=17, material="wet_asphalt")), RoadSurfaceParams(seed=3, wet=1.0).texture()
    x, y = cells((16.8, 17.2), (-0.2, 0.2))
    # darkening before or after the interpolation between texels of 2 cm
    assert_close(texture.at(x, y), wet.at(x, y), rtol=0.02, atol=0)
    assert {texture.materials[k] for k in texture.material_at(x, y).unique()} == {WET}
    assert {texture.materials[k] for k in texture.material_at(x + 3, y).unique()} == {texture.materials[0]}
