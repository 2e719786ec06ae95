"""Many closed loops as a Gymnasium vector environment, on copies of one standing world."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import torch
from gymnasium.utils import EzPickle
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from torch import Tensor

from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement, Observation, Projection
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.simulated import world_plant
from luxloop.loop.studies.batch.copies import Conditions, Copies
from luxloop.loop.studies.batch.rollouts import choose
from luxloop.loop.studies.environment.single import (
    SEEDS,
    SUCCESS,
    Floats,
    Look,
    SymbolEnv,
    action_of,
    as_gymnasium,
    centroid_distance,
    check_options,
    observation,
    reward_terms,
    start_of,
)
from luxloop.perception.extraction import ExtractionStatus
from luxloop.perception.metrics import Metrics
from luxloop.world.errors import LuxloopError, did_you_mean

Mask = npt.NDArray[np.bool_]


class SymbolVectorEnv(gymnasium.vector.VectorEnv[Any, Floats, npt.NDArray[Any]], EzPickle):
    """`num_envs` copies of `SymbolEnv` in one standing world, with the same observations, actions and rewards.

    autoreset_mode: of Gymnasium; with DISABLED, `reset(options={"reset_mask": [num_envs] bool})` resets some copies. `reset(seed=n)` gives
    the k-th copy, from 0, the seed n + k; a list of seeds is accepted as well. Latency delays observations as in the single environment.
    """

    def __init__(
        self,
        scenario: Scenario | str | Path,
        num_envs: int = 1,
        overrides: Sequence[str] = (),
        *,
        action: str = "moves",
        image: tuple[int, int] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        device: str = "cpu",
    ) -> None:
        """Parameters and errors as of `SymbolEnv`; also raises LuxloopError unless the symbol is the only function in a standing world."""
        if num_envs < 1:
            raise LuxloopError(f"num_envs: {num_envs} is too few copies; give 1 or more")
        if action == "heights":
            raise LuxloopError("action: 'heights' is drawn one by one; take luxloop.make, or moves or gains")
        EzPickle.__init__(self, scenario, num_envs, overrides, action=action, image=image, autoreset_mode=autoreset_mode, device=device)
        if autoreset_mode not in (modes := {each.value: each for each in AutoresetMode}) and autoreset_mode not in modes.values():
            raise LuxloopError(f"autoreset_mode: there is no {autoreset_mode!r}; {did_you_mean(str(autoreset_mode), modes)}")
        self.single = SymbolEnv(scenario, overrides, action=action, image=image, device=device)
        self.num_envs, self.image, self.mode = num_envs, image, AutoresetMode(autoreset_mode)
        self.metadata = {"autoreset_mode": self.mode, "render_modes": []}
        self.single_action_space, self.single_observation_space = self.single.action_space, self.single.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.prepare({})

    def prepare(self, values: dict[str, float | int]) -> None:
        """Change values of the scenario's keys, as `SymbolEnv.prepare`; call `reset` next."""
        self.single.prepare(values)
        simulation = self.single.simulation
        if simulation.scenario.camera.latency_spread_steps:
            raise LuxloopError(f"{simulation.scenario.name}: camera.latency_spread_steps: all frames of a vector are as late; set it to 0")
        self.acting, self.copies = self.single.acting, Copies(simulation)
        self.plant = world_plant(simulation.plant, "an environment")
        self.steps, self.late = simulation.scenario.steps, simulation.scenario.camera.latency_steps
        self._state: Any = None

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:  # type: ignore[override]
        if isinstance(seed, int | np.integer) or seed is None:
            given = [None if seed is None else int(seed) + k for k in range(self.num_envs)]
        else:
            given = list(seed)
        if len(given) != self.num_envs:
            raise LuxloopError(f"reset: there are {len(given)} seeds for {self.num_envs} copies; give one for each")
        super().reset(seed=given[0])
        drawn = self.np_random.integers(SEEDS, size=self.num_envs).tolist()
        seeds = [new if each is None else each for each, new in zip(given, drawn, strict=True)]
        check_options(options, "start", "reset_mask")
        fresh = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, bool)), bool)
        if fresh.shape != (self.num_envs,):
            raise LuxloopError(
                f"reset: options['reset_mask']: has the shape {fresh.shape}; give one bool for each of {self.num_envs} copies"
            )
        if self._state is None and not fresh.all():
            raise LuxloopError("reset: options['reset_mask']: all copies must begin once first")
        symbol = self.copies.symbol
        pose = (
            start_of(options, self.acting, symbol.function.start_pose.pose, (4,), (self.num_envs, 4))
            .to(symbol.projector.target)
            .expand(self.num_envs, 4)
        )
        start = self.acting.start(pose)
        if self._state is None:
            self._state, self._age, self._seeds, self._looks = start, np.zeros(self.num_envs, int), seeds, list[Look]()
            self._over, self._look = np.zeros(self.num_envs, bool), self._blind()
        self._begin(fresh, start, seeds)
        return self._observation(), {"seed": np.array(self._seeds), "_seed": fresh}

    def step(self, actions: Floats) -> tuple[Any, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        if self._state is None:
            raise LuxloopError("step: there are no episodes; call reset() first")
        over = self._over
        if over.any() and self.mode == AutoresetMode.DISABLED:
            raise LuxloopError("step: episodes are over; call reset(options={'reset_mask': ...}), or take another autoreset_mode")
        taken = action_of(actions, (self.num_envs, self.acting.size)).to(self.copies.simulation.device)
        rewards, infos = np.zeros(self.num_envs), dict[str, Any]()
        if not over.all():
            terms, metrics = self._move(taken)
            rewards = np.where(over, 0.0, sum(terms.values(), taken.new_zeros(())).double().cpu().numpy())
            success = (centroid_distance(metrics) <= SUCCESS).cpu().numpy()
            infos = _infos({"terms": terms, "verdict": vars(metrics)}, ~over) | {"is_success": success, "_is_success": ~over}
        if over.any():
            self._begin_anew(over)
        truncated = ~over & (self._age >= self.steps)
        self._over = truncated
        observed = self._observation()
        if self.mode == AutoresetMode.SAME_STEP and truncated.any():
            infos = {**infos, **_final(observed, infos, truncated)}
            self._begin_anew(truncated)
            self._over, observed = np.zeros(self.num_envs, bool), self._observation()
        return observed, rewards, np.zeros(self.num_envs, bool), truncated, infos

    def close_extras(self, **kwargs: Any) -> None:
        self._state = None

    def _move(self, actions: Tensor) -> tuple[dict[str, Tensor], Metrics]:
        """Terms of the reward and metrics of one step of all copies."""
        self._state = self.acting.act(self._state, actions)
        pose = self.acting.projection(self._state, None).pose
        light, ages = self.copies.show(pose), self._age.tolist()
        frames = [Conditions(seed, step, self.plant.disturbances) for seed, step in zip(self._seeds, ages, strict=True)]
        seen = self.copies.measure(light, frames)
        for k, each in enumerate(frames):
            if replace(self.plant, seed=each.seed).loses(each.step):
                seen[k] = self.copies.sensor.lost(pose[k], ExtractionStatus.NO_FRAME)
        looks = zip(*(vars(Look.of(each, self.image)).values() for each in seen), strict=True)
        columns: list[Any] = [None if each[0] is None else torch.stack(each) for each in looks]
        self._looks.append(Look(*columns))
        if len(self._looks) > self.late:
            self._look = choose(torch.from_numpy(self._age >= self.late).to(pose.device), self._looks.pop(0), self._blind())
        newest = replace(self._no_frame(pose), code=self._look.code, pose_error=self._look.pose_error)
        observation = Observation(newest, None, Projection(ProjectionCommand(pose), ()), latency_steps=self.late)
        self._state = self.acting.step(self._state, observation)
        self._age = self._age + 1
        metrics = self.copies.evaluate(light)
        return reward_terms(metrics, actions), metrics

    def _blind(self) -> Look:
        return Look.of(self._no_frame(self.acting.projection(self._state, None).pose), self.image)

    def _no_frame(self, pose: Tensor) -> Measurement:
        return self.copies.symbol.sensor.lost(pose, ExtractionStatus.NO_FRAME)

    def _begin_anew(self, which: Mask) -> None:
        symbol = self.copies.symbol
        pose = symbol.function.start_pose.pose.to(symbol.projector.target).expand(self.num_envs, 4)
        self._begin(which, self.acting.start(pose), self.np_random.integers(SEEDS, size=self.num_envs).tolist())

    def _begin(self, which: Mask, start: Any, seeds: Sequence[int]) -> None:
        """Reset the copies in a mask to their rows of a start state."""
        chosen = torch.from_numpy(which).to(self.copies.simulation.device)
        self._state = choose(chosen, start, self._state)
        self._seeds = [new if anew else old for anew, new, old in zip(which.tolist(), seeds, self._seeds, strict=True)]
        self._age, self._over = np.where(which, 0, self._age), self._over & ~which
        self._look = choose(chosen, self._blind(), self._look)

    def _observation(self) -> Any:
        return as_gymnasium(observation(self.acting.observation(self._state), self._look, None), self._look)


def _infos(tables: Mapping[str, Mapping[str, Tensor]], there: Mask) -> dict[str, Any]:
    """Infos of the copies that took a step, in Gymnasium's layout for vector environments: arrays, and masks of these copies."""
    told = {name: {key: value.cpu().numpy() for key, value in table.items()} for name, table in tables.items()}
    masked = {name: table | {f"_{key}": there for key in table} for name, table in told.items()}
    return masked | {f"_{name}": there for name in masked}


def _final(observed: Any, infos: dict[str, Any], over: Mask) -> dict[str, Any]:
    """Last observations and infos of the episodes that end in this step."""
    last = np.full(len(over), None, dtype=object)
    for k in np.flatnonzero(over):
        last[k] = {key: value[k] for key, value in observed.items()} if isinstance(observed, dict) else observed[k]
    return {"final_obs": last, "_final_obs": over, "final_info": infos, "_final_info": over}
