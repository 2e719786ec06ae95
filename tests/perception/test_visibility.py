"""Figures of how well things stand out: analytic cases, and gradients."""

import pytest
import torch

from luxloop.perception.metrics import edge_definition, unevenness, weber_contrast
from luxloop.perception.metrics import ring as around

MASK = torch.zeros(40, 60, dtype=torch.bool)
MASK[10:30, 20:40] = True


def patch(own: float, background: float) -> torch.Tensor:
    return torch.where(MASK, own, background).double()


def test_weber_contrast_is_the_difference_over_the_background() -> None:
    assert float(weber_contrast(patch(3.0, 1.0), MASK, 0.0)) == pytest.approx(2.0)
    assert float(weber_contrast(patch(0.25, 1.0), MASK, 0.0)) == pytest.approx(0.75)
    assert float(weber_contrast(1e-6 * patch(3.0, 1.0), MASK, 1e-3)) < 0.01  # nobody can tell


def test_edges_are_as_steep_as_the_ratio_says() -> None:
    one = edge_definition(patch(2.0, 1.0), MASK, 0.0)
    assert float(edge_definition(patch(4.0, 1.0), MASK, 0.0)) == pytest.approx(2 * float(one))
    assert float(edge_definition(patch(1.0, 1.0), MASK, 0.0)) < 1e-5
    assert float(one) == pytest.approx(0.693, rel=0.05)  # log 2 a px; at the one corner that counts it is steeper by root two


def test_even_light_is_even() -> None:
    assert float(unevenness(patch(5.0, 0.0), MASK, 0.0)) == pytest.approx(0.0)
    stripes = torch.arange(60.0).remainder(2).expand(40, 60)
    assert float(unevenness(stripes, MASK, 0.0)) == pytest.approx(1.0)


def test_the_ring_lies_around() -> None:
    ring = around(MASK, 3)
    assert not bool((ring & MASK).any()) and int(ring.sum()) == 26 * 26 - 20 * 20


@pytest.mark.parametrize("measure", [weber_contrast, edge_definition, unevenness])
def test_gradients_are_right(measure) -> None:
    light = torch.rand(40, 60, dtype=torch.float64, generator=torch.Generator().manual_seed(3)).add(0.5).requires_grad_(True)
    assert torch.autograd.gradcheck(lambda image: measure(image, MASK, 0.01), (light,), fast_mode=True)
