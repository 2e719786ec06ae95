"""Functions that make environments, `make` and `make_vec`, and registration of the shipped single-symbol scenarios with Gymnasium."""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.shipped import scenario_files
from luxloop.world.errors import LuxloopError

if TYPE_CHECKING:
    from luxloop.loop.studies.environment.single import SymbolEnv
    from luxloop.loop.studies.environment.stable_baselines import Group, SymbolVecEnv
    from luxloop.loop.studies.environment.vector import SymbolVectorEnv

IDS: Mapping[str, str] = {"": "moves", "Gains": "gains", "Heights": "heights"}
SINGLE = "luxloop.loop.studies.environment.single:SymbolEnv"
VECTOR = "luxloop.loop.studies.environment.vector:SymbolVectorEnv"


def make(
    scenario: Scenario | str | Path,
    /,
    *overrides: str,
    action: Literal["moves", "gains", "heights"] = "moves",
    image: tuple[int, int] | None = None,
    render_mode: Literal["rgb_array", "human"] | None = None,
    device: str = "cpu",
) -> "SymbolEnv":
    """Gymnasium environment in which the agent holds the scenario's symbol; its docstring has spaces, units and signs.

    scenario: a loaded scenario, or a name or path. overrides: changes of its keys, as KEY=VALUE. action: the kind of action. image: rows
    and columns of the symbol's image in observations; by default there is no image. render_mode: "rgb_array" to get the camera's view from
    `render`, "human" to show it in a window. device: "cpu" or "cuda". Raises LuxloopError if Gymnasium is missing, and as `SymbolEnv`.
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
    """Gymnasium `VectorEnv` of num_envs copies of `make`'s environment, for scenarios in which nothing but the symbol moves.

    num_envs: number of copies. autoreset_mode: one of `gymnasium.vector.AutoresetMode`. scenario, overrides, action, image, device and
    errors: as for `make`; also raises LuxloopError if something else moves, or the symbol is not the only function.
    """
    _needs_gymnasium()
    from luxloop.loop.studies.environment.vector import SymbolVectorEnv

    return SymbolVectorEnv(scenario, num_envs, overrides, action=action, image=image, autoreset_mode=autoreset_mode, device=device)


def make_sb3(copies: "Group", /, *more: "Group", starts: tuple[Sequence[float], Sequence[float]] | None = None) -> "SymbolVecEnv":
    """`VecEnv` for the algorithms of Stable-Baselines3, of one or more groups of copies, each group in its own world.

    copies, more: of `make_vec` with autoreset_mode="Disabled" and equal steps, or a `RandomisedVector` of them, which draws their worlds.
    starts: least and greatest start pose (x, y in m, roll, pitch in rad), between which each copy's is drawn; by default the scenario's
    start. Raises LuxloopError if Stable-Baselines3 is missing, or for another autoreset mode.
    """
    try:
        from luxloop.loop.studies.environment.stable_baselines import SymbolVecEnv
    except ImportError as error:
        raise LuxloopError("make_sb3: needs Stable-Baselines3, which is not installed; get it with pip install 'luxloop[sb3]'") from error
    return SymbolVecEnv((copies, *more), starts)


def _needs_gymnasium() -> None:
    try:
        import gymnasium  # noqa: F401
    except ImportError as error:
        raise LuxloopError("make: needs Gymnasium, which is not installed; get it with pip install 'luxloop[gym]'") from error


def register() -> tuple[str, ...]:
    """Register `luxloop/Snowflake-v0`, `luxloop/SnowflakeGains-v0`, `luxloop/SnowflakeHeights-v0` and so on; returns all ids."""
    import gymnasium

    ids = []
    for name in symbols():
        camel = "".join(part.capitalize() for part in name.split("_"))
        for ending, action in IDS.items():
            ids.append(f"luxloop/{camel}{ending}-v0")
            if ids[-1] not in gymnasium.registry:
                vector = None if action == "heights" else VECTOR
                gymnasium.register(ids[-1], SINGLE, vector_entry_point=vector, kwargs={"scenario": name, "action": action})
    return tuple(ids)


def symbols() -> Iterator[str]:
    """Names of the shipped scenarios with exactly one held symbol."""
    for name, path in scenario_files().items():
        functions = tomllib.loads(path.read_text("utf-8")).get("functions", {})
        if sum("controller" in each for each in functions.values()) == 1:
            yield name
