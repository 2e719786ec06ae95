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

Group = SymbolVectorEnv | RandomisedVector


class SymbolVecEnv(VecEnv):
    """Groups of copies whose episodes end in the same step and begin anew together; see `luxloop.loop.studies.environment.make.make_sb3`.

    Infos are those of `SymbolEnv`, with `terminal_observation` and `TimeLimit.truncated` at the end of an episode.
    """

    def __init__(self, groups: Sequence[Group], starts: tuple[Sequence[float], Sequence[float]] | None = None) -> None:
        if any(each.metadata["autoreset_mode"] != AutoresetMode.DISABLED for each in groups):
            raise LuxloopError('autoreset_mode: episodes of a VecEnv begin anew together; give autoreset_mode="Disabled" to make_vec')
        self.groups, self.starts, self.render_mode = groups, starts, None
        self._first = np.cumsum([0, *(each.num_envs for each in groups)])  # copy of each group, and their number
        self._generator = np.random.default_rng()
        super().__init__(int(self._first[-1]), groups[0].single_observation_space, groups[0].single_action_space)

    def reset(self) -> VecEnvObs:
        if self._seeds[0] is not None:
            self._generator = np.random.default_rng(self._seeds[0])
        observed, self.reset_infos = list[VecEnvObs](), list[dict[str, Any]]()
        for group, first in zip(self.groups, self._first[:-1], strict=True):
            poses = self.starts and {"start": self._generator.uniform(*self.starts, (group.num_envs, 4))}
            begun, told = group.reset(seed=self._seeds[first], options=poses)
            observed.append(begun)
            self.reset_infos += [_of_copy(told, k) for k in range(group.num_envs)]
        self._reset_seeds()
        return _join(observed)

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        actions = np.split(self._actions, self._first[1:-1])
        steps = [group.step(each) for group, each in zip(self.groups, actions, strict=True)]
        infos = [_of_copy(each[4], k) for group, each in zip(self.groups, steps, strict=True) for k in range(group.num_envs)]
        rewards, truncated = (np.concatenate([each[k] for each in steps]) for k in (1, 3))
        observed = _join([each[0] for each in steps])
        if truncated.all():
            last, observed = observed, self.reset()
            for k, info in enumerate(infos):
                info["terminal_observation"] = {key: value[k] for key, value in last.items()} if isinstance(last, dict) else last[k]
                info["TimeLimit.truncated"] = True
        return observed, rewards.astype(np.float32), truncated, infos

    def close(self) -> None:
        for each in self.groups:
            each.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        owners = [group.unwrapped for group in self.groups for _ in range(group.num_envs)]
        return [getattr(owners[k], attr_name) for k in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        raise LuxloopError(f"set_attr: {attr_name}: copies of a group share one world; change its keys with RandomisedVector")

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        raise LuxloopError(f"env_method: {method_name}: copies of a group share one world; call methods of the vector environment")

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        return [False] * len(list(self._get_indices(indices)))


def _join(observed: Sequence[Any]) -> VecEnvObs:
    """Observations of all copies from those of each group, arrays or dictionaries of arrays."""
    if isinstance(observed[0], dict):
        return {key: np.concatenate([each[key] for each in observed]) for key in observed[0]}
    return np.concatenate(observed)


def _of_copy(told: dict[str, Any], k: int) -> dict[str, Any]:
    """Info of the k-th copy from those in Gymnasium's layout for vector environments."""
    return {
        key: _of_copy(value, k) if isinstance(value, dict) else value[k]
        for key, value in told.items()
        if not key.startswith("_") and (isinstance(value, dict) or f"_{key}" in told)
    }
