"""Domain randomisation: other worlds in other episodes, drawn within ranges of the scenario's keys."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np

from loop.environment.single import SymbolEnv
from loop.environment.vector import SymbolVectorEnv
from loop.studies import ranges
from loop.studies.ranges import Range


class Randomised(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Draws values of keys for each episode, from the seed of `reset`. `info["values"]` of `reset` has them, by key.

    What a key changes is prepared anew: noise and latency cost nothing, a road or a lamp up to a second, so `every` episodes share a world.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], keys: Sequence[str], every: int = 1) -> None:
        """keys: ranges as `luxloop tune` has them, KEY=LOW:HIGH or KEY=LOW:HIGH:log: "road.seed=1:1000", "camera.latency_steps=0:2".

        Raises LuxloopError for a key or an end that the scenario does not take.
        """
        super().__init__(env)
        self._drawn = _Drawn(env.unwrapped, keys, every)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        values = self._drawn.next(seed)
        observed, info = self.env.reset(seed=seed, options=options)
        return observed, {**info, "values": values}


class RandomisedVector(gymnasium.vector.VectorWrapper):
    """The same of a vector environment, whose copies share a world. Copies that begin by themselves stay in it: draw with `reset`."""

    def __init__(self, env: gymnasium.vector.VectorEnv[Any, Any, Any], keys: Sequence[str], every: int = 1) -> None:
        super().__init__(env)
        self._drawn = _Drawn(env.unwrapped, keys, every)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        values = self._drawn.next(seed if isinstance(seed, int) or seed is None else seed[0])
        observed, info = self.env.reset(seed=seed, options=options)
        return observed, {**info, "values": values}


class _Drawn:
    """Values of keys, drawn anew after `every` episodes."""

    def __init__(self, env: Any, keys: Sequence[str], every: int) -> None:
        assert isinstance(env, SymbolEnv | SymbolVectorEnv)
        scenario = env.scenario if isinstance(env, SymbolEnv) else env.single.scenario
        self.env, self.every, self.episode = env, every, 0
        self.ranges = [ranges.parse(key, [scenario]) for key in keys]
        self.generator, self.values = np.random.default_rng(), dict[str, float | int]()

    def next(self, seed: int | None) -> Mapping[str, float | int]:
        """Those of the next episode; the environment is prepared for them."""
        if seed is not None:
            self.generator, self.episode = np.random.default_rng(seed), 0
        if self.episode % self.every == 0:
            self.values = {each.key: _value(each, self.generator) for each in self.ranges}
            self.env.prepare(self.values)
        self.episode += 1
        return self.values


def _value(wanted: Range, generator: np.random.Generator) -> float | int:
    low, high = wanted.low, wanted.high
    if wanted.whole:
        return int(generator.integers(int(low), int(high), endpoint=True))
    if wanted.log:
        return math.exp(generator.uniform(math.log(low), math.log(high)))
    return float(generator.uniform(low, high))
