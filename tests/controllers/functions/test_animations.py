"""What animations do to a symbol, and that they come back to where they began."""

import pytest
import torch

from luxloop.controllers.functions.animations import Animation, BlinkingParams, RunningLightParams, WipeParams
from luxloop.world.symbols import Still

WHITE = Still(torch.ones(10, 20))


def test_blinking_is_on_for_its_share_of_the_time() -> None:
    symbol = Animation(WHITE, BlinkingParams(rate_hz=2, duty=0.25))
    assert [symbol.at(t).mean().item() for t in (0, 0.1, 0.13, 0.4, 0.5, 0.6)] == [1, 1, 0, 0, 1, 1]
    assert symbol.at(0).shape == (10, 20)


def test_a_homogeneous_symbol_blinks_as_one_texel() -> None:
    assert Animation(Still(torch.ones(1, 1)), BlinkingParams()).at(0).shape == (1, 1)
    assert Animation(Still(torch.ones(1, 1)), WipeParams()).at(0).shape == (64, 64)


@pytest.mark.parametrize(("direction", "way"), [("away", (-1, 0)), ("towards", (1, 0)), ("left", (0, -1)), ("right", (0, 1))])
def test_a_running_light_runs_in_its_direction(direction: str, way: tuple[int, int]) -> None:
    symbol = Animation(WHITE, RunningLightParams(period_s=2, direction=direction))
    early, late = (torch.tensor(divmod(symbol.at(t).argmax().item(), 20)) for t in (0.7, 1.3))
    assert torch.sign(late - early).tolist() == list(way)
    torch.testing.assert_close(symbol.at(0.5), symbol.at(2.5))
    assert not Animation(WHITE, RunningLightParams(rest=0.0)).at(0).max() > 0.05  # it comes in from beyond the border
    assert Animation(WHITE, RunningLightParams(rest=0.4)).at(0.3).min() >= 0.4


def test_a_wipe_draws_holds_and_starts_over() -> None:
    symbol = Animation(WHITE, WipeParams(draw_s=1.0, hold_s=1.0, direction="right"))
    shares = [symbol.at(t).mean().item() for t in (0, 0.25, 0.5, 0.75, 1.0, 1.9, 2.0)]
    assert shares[0] == 0 and shares[4] == shares[5] == 1 and shares[6] == 0
    assert shares[:5] == sorted(shares[:5])
    half = symbol.at(0.5)[0]
    assert half[:8].min() == 1 and half[12:].max() == 0
