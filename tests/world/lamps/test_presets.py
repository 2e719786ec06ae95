"""Shipped lamps are as published."""

import pytest
import torch
from torch import Tensor

from luxloop.world.headlight.lamp import Lamp, direction
from luxloop.world.headlight.parametric import LUMINANCE
from luxloop.world.lamps.patterns import PATTERNS
from luxloop.world.lamps.presets import NAMES, lamp
from tests.refusal import refusal


def seen(lamp: Lamp, h_deg: Tensor, v_deg: Tensor) -> Tensor:
    return lamp.intensity(lamp.beam("full"), direction(h_deg, v_deg).flatten(1)).reshape(h_deg.shape)


@pytest.mark.parametrize(
    ("name", "pixels"),
    [
        ("idealised-332x1024", [(332, 1024)]),
        ("hd84", [(3, 28)]),
        ("ssl-hd-lores", [(64, 256)]),
        ("ssl-hd-hires", [(64, 256)]),
        ("ssl-hd", [(64, 256), (64, 256), (1, 3), (1, 3), (1, 1)]),
        ("hybrid-hd", [(64, 256), (332, 1024)]),
        ("dmd-1m3", [(1152, 1152)]),
    ],
)
def test_pixels_are_those_published_and_memory_is_bounded(name, pixels):
    modules = lamp(name).modules
    assert [(module.headlight.pixel_rows, module.headlight.pixel_cols) for module in modules] == pixels
    for module in modules:
        light = module.headlight
        stored = sum(array.nbytes for array in (light.matrix.indptr, light.matrix.indices, light.matrix.values))
        assert stored < 100e6
        assert light.matrix.indices.unique().numel() == light.n_pixels, "every pixel lights a texel"
        assert (light.matrix.values > 0).all()


def test_all_names_are_tested():
    assert set(NAMES) == {"idealised-332x1024", "hd84", "ssl-hd-lores", "ssl-hd-hires", "ssl-hd", "hybrid-hd", "dmd-1m3"}
    assert all("Published" in lamp(name).notes and "Guessed" in lamp(name).notes for name in NAMES)


@pytest.mark.parametrize(("name", "width", "height"), [("hd84", 20, 5), ("ssl-hd-lores", 20, 5), ("ssl-hd-hires", 10, 2.5)])
def test_the_field_ends_where_it_is_published_to(name, width, height):
    """Half of the middle's light of the same row or column, or more, within the border; none much beyond it."""
    side = torch.tensor([-1.1, -0.93, 0.0, 0.93, 1.1])
    across = seen(lamp(name), side * width, torch.full_like(side, 0.1))
    assert (across[[1, 3]] > 0.4 * across[2]).all() and (across[[0, 4]] < 0.01 * across[2]).all()
    down = seen(lamp(name), torch.zeros(5), side * height)
    assert (down[[1, 3]] > 380).all() and (down[[0, 4]] < 0.01 * down[2]).all()


def test_the_cornering_light_lies_on_the_outside_and_the_lamp_can_bend_further_outwards():
    for side, sign in (("left", -1.0), ("right", 1.0)):
        module = lamp("ssl-hd", side).module("cornering")
        intensity = module.headlight.intensity(
            module.headlight.light_texture(torch.ones(1)),
            direction(torch.tensor([45.0 * sign, -45.0 * sign]), torch.full((2,), -3.5)).float(),
        )
        assert intensity[0] > 3000 and intensity[1] == 0
        swivel = lamp("ssl-hd", side).module("lores").swivel_deg
        assert max(swivel, key=abs) == -15 * sign


def test_coloured_edges_keep_the_luminance():
    light = lamp("hd84", chromatic_shift=0.01).modules[0].headlight
    # Sums of three float32 numbers of order one, the blue one up to 14.
    torch.testing.assert_close(torch.tensor(LUMINANCE) @ light.chroma, torch.ones(light.chroma.shape[1]), atol=3e-6, rtol=0)
    u = torch.rand(light.n_pixels, generator=torch.Generator().manual_seed(1))
    colours, intensity = light.colour_texture(u), light.light_texture(u)
    torch.testing.assert_close(torch.einsum("c,cij->ij", torch.tensor(LUMINANCE), colours), intensity, rtol=1e-4, atol=1e-2)
    assert light.n_pixels == lamp("hd84").modules[0].headlight.n_pixels


def test_an_unknown_lamp_or_side_is_named_with_what_there_is():
    with refusal(r"no lamp 'ssl-hd-lowres'; did you mean 'ssl-hd-lores'\?"):
        lamp("ssl-hd-lowres")
    with refusal("no lamp 'halogen'; known are idealised-332x1024, hd84"):
        lamp("halogen")
    with refusal(r"side is 'left' or 'right', not 'top'"):
        lamp("hd84", "top")  # type: ignore[arg-type]
    with refusal("no coloured edges"):
        lamp("idealised-332x1024", chromatic_shift=0.01)


def test_each_beam_is_fitted_once_and_only_when_asked_for(monkeypatch):
    fitted = []
    monkeypatch.setattr("luxloop.world.lamps.fitting.fit", lambda lamp, pattern, traffic: fitted.append(pattern) or lamp.beam("off"))
    lamp.cache_clear()
    one = lamp("hd84")
    one.beam("full")
    assert list(one.beams) == list(PATTERNS) and len(one.beams) == len(PATTERNS) and one.default_beam == "low"
    with refusal("no beam 'lwo'; it has low, high"):
        one.beam("lwo")
    assert not fitted
    assert (one.beam("low")[0] == 0).all() and one.beam("low") is one.beam("low")
    assert fitted == [PATTERNS["low"]]
    lamp.cache_clear()


def test_the_outer_edges_are_bluish_and_the_middle_is_white():
    light = lamp("ssl-hd-lores", chromatic_shift=0.01).modules[0].headlight
    red, _, blue = light.colour_texture(torch.ones(light.n_pixels))
    lit = light.light_texture(torch.ones(light.n_pixels)) > 100
    outermost = int(lit[light.rows // 2].nonzero()[0])
    assert blue[light.rows // 2, outermost] > 1.5 * red[light.rows // 2, outermost]
    assert blue[light.rows // 2, light.cols // 2] == pytest.approx(float(red[light.rows // 2, light.cols // 2]), rel=0.03)
