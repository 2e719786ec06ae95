"""Domain randomisation: random values of scenario keys for new episodes."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from luxloop.loop.studies import ranges
from luxloop.loop.studies.environment.single import SymbolEnv
from luxloop.world.errors import LuxloopError


class _Randomised:
    """Base of both wrappers."""

    env: Any

    def __init__(self, env: Any, keys: Sequence[str], every: int = 1) -> None:
        super().__init__(env)  # type: ignore[call-arg]
        inner = env.unwrapped
        scenario = inner.scenario if isinstance(inner, SymbolEnv) else inner.single.scenario
        if every < 1:
            raise LuxloopError(f"every: {every} is too few episodes; give 1 or more")
        self.every, self.episode, self.values = every, 0, dict[str, float | int]()
        self.ranges = [ranges.parse(key, [scenario]) for key in keys]
        self.generator = np.random.default_rng()

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        if (first := seed if isinstance(seed, int | None) else seed[0]) is not None:
            self.generator, self.episode = np.random.default_rng(first), 0
        if self.episode % self.every == 0:
            self.values = {each.key: each.draw(self.generator) for each in self.ranges}
            self.env.unwrapped.prepare(self.values)
        self.episode += 1
        observed, info = self.env.reset(seed=seed, options=options)
        return observed, {**info, "values": self.values}


class Randomised(_Randomised, gymnasium.Wrapper[Any, Any, Any, Any]):
    """Wrapper that draws values of keys for new episodes, from the seed of `reset`; `info["values"]` of `reset` has them by key.

    env: of `make`. keys: ranges as for `luxloop tune`, KEY=LOW:HIGH or KEY=LOW:HIGH:log, such as "road.seed=1:1000". every: number of
    episodes with the same values. Only what a key affects is prepared again: noise or latency take no time, a road or a lamp up to a
    second. Raises LuxloopError for an invalid key or value.
    """


class RandomisedVector(_Randomised, gymnasium.vector.VectorWrapper):
    """`Randomised` for a vector environment, whose copies share the values. Only `reset` draws new ones, not an automatic reset."""
