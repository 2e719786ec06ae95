"""Functions that make environments: `make` and `make_vec`."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from luxloop.loop.scenario.model import Scenario
from luxloop.world.errors import LuxloopError

if TYPE_CHECKING:
    from luxloop.loop.studies.environment.single import SymbolEnv
    from luxloop.loop.studies.environment.vector import SymbolVectorEnv


def make(
    scenario: Scenario | str | Path,
    /,
    *overrides: str,
    action: Literal["moves", "gains", "heights"] = "moves",
    image: tuple[int, int] | None = None,
    render_mode: Literal["rgb_array", "human"] | None = None,
    device: str = "cpu",
) -> "SymbolEnv":
    """An environment of Gymnasium in which the agent holds the scenario's symbol; its docstring has spaces, units and signs.

    scenario: a loaded scenario, or a name or path. overrides: changes of its keys, as KEY=VALUE. action: the kind of action. image: rows
    and columns of the symbol's image in observations; by default they have no image. render_mode: "rgb_array" if `render` returns the
    camera's view, "human" if a window shows it. device: "cpu" or "cuda". Raises LuxloopError if Gymnasium is missing, and as `SymbolEnv`.
    """
    _needs_gymnasium()
    from luxloop.loop.studies.environment.single import SymbolEnv

    return SymbolEnv(scenario, overrides, action=action, image=image, render_mode=render_mode, device=device)


def make_vec(
    scenario: Scenario | str | Path,
    num_envs: int,
    /,
    *overrides: str,
    action: Literal["moves", "gains"] = "moves",
    image: tuple[int, int] | None = None,
    autoreset_mode: Any = "NextStep",
    device: str = "cpu",
) -> "SymbolVectorEnv":
    """A `VectorEnv` of Gymnasium with num_envs copies of `make`'s environment; for scenarios in which nothing but the symbol moves.

    num_envs: number of copies. autoreset_mode: one of `gymnasium.vector.AutoresetMode`. scenario, overrides, action, image, device and
    errors: as for `make`; also raises LuxloopError if something else moves, or the symbol is not the only function.
    """
    _needs_gymnasium()
    from luxloop.loop.studies.environment.vector import SymbolVectorEnv

    return SymbolVectorEnv(scenario, num_envs, overrides, action=action, image=image, autoreset_mode=autoreset_mode, device=device)


def _needs_gymnasium() -> None:
    try:
        import gymnasium  # noqa: F401
    except ImportError as error:
        raise LuxloopError("make: needs Gymnasium, which is not installed; get it with pip install 'luxloop[gym]'") from error
