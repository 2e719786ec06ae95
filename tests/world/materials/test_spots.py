"""Paint, patches and puddles on the road."""

import pytest
import torch

from luxloop.world.materials.library import WET, RoadSurfaceParams, SpotParams, SpottedTexture

DRY = RoadSurfaceParams(seed=3)


def spotted(*spots: SpotParams, surface: RoadSurfaceParams = DRY) -> SpottedTexture:
    return SpottedTexture(surface, spots)


def cells(x_m: tuple[float, float], y_m: tuple[float, float], step_m: float = 0.01) -> tuple[torch.Tensor, torch.Tensor]:
    """Centres of cells of a rectangle of the road."""
    x, y = (torch.arange(low + step_m / 2, high, step_m, dtype=torch.float64) for low, high in (x_m, y_m))
    return x[:, None].expand(-1, len(y)), y.expand(len(x), -1)


@pytest.mark.parametrize(("shape", "area_m2"), [("rectangle", 6.0), ("ellipse", 6.0 * torch.pi / 4)])
def test_a_turned_spot_covers_its_area(shape: str, area_m2: float) -> None:
    spot = SpotParams(shape=shape, x_m=17, y_m=1, length_m=4.0, width_m=1.5, yaw_deg=30)
    x, y = cells((13, 21), (-3, 5))
    there = spot.covers(x, y)
    # cells of 1 cm along an outline of at most 11 m: half of them may err, evenly to both sides
    assert float(there.sum()) * 1e-4 == pytest.approx(area_m2, rel=2e-3)
    assert float(x[there].mean()) == pytest.approx(17, abs=5e-3) and float(y[there].mean()) == pytest.approx(1, abs=5e-3)
    ahead_on_the_left = torch.tensor([17 + 1.9 * 0.866]), torch.tensor([1 + 1.9 * 0.5])
    assert spot.covers(*ahead_on_the_left).all()


def test_a_puddle_is_what_a_wet_road_is() -> None:
    texture, wet = spotted(SpotParams(x_m=17, material="wet_asphalt")), RoadSurfaceParams(seed=3, wet=1.0).texture()
    x, y = cells((16.8, 17.2), (-0.2, 0.2))
    # darkening before or after the interpolation between texels of 2 cm
    torch.testing.assert_close(texture.at(x, y), wet.at(x, y), rtol=0.02, atol=0)
    assert {texture.materials[k] for k in texture.material_at(x, y).unique()} == {WET}
    assert {texture.materials[k] for k in texture.material_at(x + 3, y).unique()} == {texture.materials[0]}
