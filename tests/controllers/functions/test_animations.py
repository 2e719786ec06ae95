"""What animations do to a symbol, and that they come back to where they began."""

from functools import partial

import pytest
import torch

from luxloop.controllers.functions.animations import BlinkingParams, RunningLightParams, WipeParams, animate
from luxloop.world.symbols import Still

WHITE = Still(torch.ones(10, 20))


def test_blinking_is_on_for_its_share_of_the_time():
    images = [animate(WHITE, BlinkingParams(rate_hz=2, duty=0.25), t) for t in (0, 0.1, 0.13, 0.4, 0.5, 0.6)]
    assert [image is not None for image in images] == [True, True, False, False, True, True]
    assert images[0] is not None and torch.equal(images[0], torch.ones(10, 20))


def test_a_homogeneous_symbol_gets_texels_where_its_brightness_changes_over_them():
    one = Still(torch.ones(1, 1))
    assert [len(animate(one, each, 0.0)) for each in (None, BlinkingParams(), WipeParams())] == [1, 1, 64]


@pytest.mark.parametrize(("direction", "way"), [("away", (-1, 0)), ("towards", (1, 0)), ("left", (0, -1)), ("right", (0, 1))])
def test_a_running_light_runs_in_its_direction(direction, way):
    symbol = partial(animate, WHITE, RunningLightParams(period_s=2, direction=direction))
    early, late = (torch.tensor(divmod(symbol(t).argmax().item(), 20)) for t in (0.7, 1.3))
    assert torch.sign(late - early).tolist() == list(way)
    torch.testing.assert_close(symbol(0.5), symbol(2.5))
    assert not animate(WHITE, RunningLightParams(rest=0.0), 0).max() > 0.05  # it comes in from beyond the border
    assert animate(WHITE, RunningLightParams(rest=0.4), 0.3).min() >= 0.4


def test_a_wipe_draws_holds_and_starts_over():
    symbol = partial(animate, WHITE, WipeParams(draw_s=1.0, hold_s=1.0, direction="right"))
    shares = [symbol(t).mean().item() for t in (0, 0.25, 0.5, 0.75, 1.0, 1.9, 2.0)]
    assert shares[0] == 0 and shares[4] == shares[5] == 1 and shares[6] == 0
    assert shares[:5] == sorted(shares[:5])
    half = symbol(0.5)[0]
    assert half[:8].min() == 1 and half[12:].max() == 0
