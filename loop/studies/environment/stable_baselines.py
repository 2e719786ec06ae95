"""Copies of a closed loop as a `VecEnv` of Stable-Baselines3."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from luxloop.loop.studies.environment.randomised import RandomisedVector
from luxloop.loop.studies.environment.vector import SymbolVectorEnv
from luxloop.world.errors import LuxloopError


class SymbolVecEnv(VecEnv):
    """Copies whose episodes end in the same step and begin anew together; see `luxloop.loop.studies.environment.make.make_sb3`.

    Infos are those of `SymbolEnv`, with `terminal_observation` and `TimeLimit.truncated` at the end of an episode.
    """

    def __init__(self, copies: SymbolVectorEnv | RandomisedVector, starts: tuple[Sequence[float], Sequence[float]] | None = None) -> None:
        if copies.metadata["autoreset_mode"] != AutoresetMode.DISABLED:
            raise LuxloopError('autoreset_mode: episodes of a VecEnv begin anew together; give autoreset_mode="Disabled" to make_vec')
        self.copies, self.starts, self.render_mode = copies, starts, None
        self._generator = np.random.default_rng()
        super().__init__(copies.num_envs, copies.single_observation_space, copies.single_action_space)

    def reset(self) -> VecEnvObs:
        if (first := self._seeds[0]) is not None:
            self._generator = np.random.default_rng(first)
        poses = self.starts and {"start": self._generator.uniform(*self.starts, (self.num_envs, 4))}
        observed, told = self.copies.reset(seed=first, options=poses)
        self.reset_infos = [_of_copy(told, k) for k in range(self.num_envs)]
        self._reset_seeds()
        return observed

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        observed, rewards, _, truncated, told = self.copies.step(self._actions)
        infos: list[dict[str, Any]] = [_of_copy(told, k) for k in range(self.num_envs)]
        if truncated.all():
            last, observed = observed, self.reset()
            for k, info in enumerate(infos):
                info["terminal_observation"] = {key: value[k] for key, value in last.items()} if isinstance(last, dict) else last[k]
                info["TimeLimit.truncated"] = True
        return observed, rewards.astype(np.float32), truncated, infos

    def close(self) -> None:
        self.copies.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        return [getattr(self.copies.unwrapped, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        raise LuxloopError(f"set_attr: {attr_name}: copies share one world; change its keys with RandomisedVector")

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        raise LuxloopError(f"env_method: {method_name}: copies share one world; call methods of the vector environment")

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        return [False] * len(list(self._get_indices(indices)))


def _of_copy(told: dict[str, Any], k: int) -> dict[str, Any]:
    """Info of the k-th copy from those in Gymnasium's layout for vector environments."""
    return {
        key: _of_copy(value, k) if isinstance(value, dict) else value[k]
        for key, value in told.items()
        if not key.startswith("_") and (isinstance(value, dict) or f"_{key}" in told)
    }
