"""Domain randomisation: values of the scenario's keys, drawn within ranges for new episodes."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np

from luxloop.loop.studies import ranges
from luxloop.loop.studies.environment.single import SymbolEnv
from luxloop.loop.studies.environment.vector import SymbolVectorEnv
from luxloop.world.errors import LuxloopError


class Randomised(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Draws values of keys for new episodes, from the seed of `reset`; `info["values"]` of `reset` has them by key.

    Only what a key affects is prepared again: a change of noise or latency takes no time, one of a road or a lamp up to a second.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], keys: Sequence[str], every: int = 1) -> None:
        """env: of `make`. keys: ranges as for `luxloop tune`, KEY=LOW:HIGH or KEY=LOW:HIGH:log, such as "road.seed=1:1000". every: episodes
        that share the values.

        Raises LuxloopError for a key or a value that the scenario does not accept.
        """
        super().__init__(env)
        self._draw = _Draw(env.unwrapped, keys, every)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        values = self._draw.next(seed)
        observed, info = self.env.reset(seed=seed, options=options)
        return observed, {**info, "values": values}


class RandomisedVector(gymnasium.vector.VectorWrapper):
    """The same for a vector environment, whose copies share the values. Only `reset` draws new ones, not an automatic reset."""

    def __init__(self, env: gymnasium.vector.VectorEnv[Any, Any, Any], keys: Sequence[str], every: int = 1) -> None:
        super().__init__(env)
        self._draw = _Draw(env.unwrapped, keys, every)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        values = self._draw.next(seed if isinstance(seed, int) or seed is None else seed[0])
        observed, info = self.env.reset(seed=seed, options=options)
        return observed, {**info, "values": values}


class _Draw:
    """Values of keys, drawn anew after `every` episodes."""

    def __init__(self, env: Any, keys: Sequence[str], every: int) -> None:
        assert isinstance(env, SymbolEnv | SymbolVectorEnv)
        scenario = env.scenario if isinstance(env, SymbolEnv) else env.single.scenario
        if every < 1:
            raise LuxloopError(f"every: {every} is too few episodes; give 1 or more")
        self.env, self.every, self.episode = env, every, 0
        self.ranges = [ranges.parse(key, [scenario]) for key in keys]
        self.generator, self.values = np.random.default_rng(), dict[str, float | int]()

    def next(self, seed: int | None) -> Mapping[str, float | int]:
        """Values of the next episode, for which the environment is prepared."""
        if seed is not None:
            self.generator, self.episode = np.random.default_rng(seed), 0
        if self.episode % self.every == 0:
            self.values = {each.key: each.draw(self.generator) for each in self.ranges}
            self.env.prepare(self.values)
        self.episode += 1
        return self.values
