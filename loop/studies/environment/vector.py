"""Many closed loops as one vector environment of Gymnasium, on copies of one world at rest."""

from collections.abc import Sequence
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
from luxloop.controllers.symbol.sensing.protocol import Observation, Projection
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.simulated import world_plant
from luxloop.loop.studies.batch.copies import Copies
from luxloop.loop.studies.batch.laws import rows
from luxloop.loop.studies.batch.looking import Taken
from luxloop.loop.studies.environment.single import SEEDS, SymbolEnv, start_of
from luxloop.loop.studies.environment.task import Floats, Look, Reward, action_of, as_gymnasium, observation, reward
from luxloop.perception.extraction import ExtractionStatus
from luxloop.perception.metrics import Metrics
from luxloop.world.errors import LuxloopError

Mask = npt.NDArray[np.bool_]


class SymbolVectorEnv(gymnasium.vector.VectorEnv[Any, Floats, npt.NDArray[Any]], EzPickle):
    """`num_envs` copies of `SymbolEnv` in one standing world; observations, actions and rewards of each are those of `SymbolEnv`.

    autoreset_mode: of Gymnasium; with DISABLED, `reset(options={"reset_mask": [num_envs] bool})` resets some copies. `reset(seed=n)` gives
    the k-th copy, from 0, the seed n + k; it also takes a list of seeds. Latency delays observations as in the single environment.
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
        fresh = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, bool)), bool)
        if self._state is None and not fresh.all():
            raise LuxloopError("reset: options['reset_mask']: all copies must begin once first")
        symbol = self.copies.symbol
        pose = (
            start_of(options, symbol.function.start_pose.pose, (4,), (self.num_envs, 4))
            .to(symbol.projector.target)
            .expand(self.num_envs, 4)
        )
        start = self.acting.start(pose)
        if self._state is None:
            self._state, self._age, self._seeds, self._looks = start, np.zeros(self.num_envs, int), seeds, list[Look]()
            self._over, self._seen = np.zeros(self.num_envs, bool), self._nothing_seen()
        self._begin(fresh, start, seeds)
        return self._observed(), {}

    def step(self, actions: Floats) -> tuple[Any, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        if self._state is None:
            raise LuxloopError("step: there are no episodes; call reset() first")
        over = self._over
        if over.any() and self.mode == AutoresetMode.DISABLED:
            raise LuxloopError("step: episodes are over; call reset(options={'reset_mask': ...}), or take another autoreset_mode")
        taken = action_of(actions, (self.num_envs, self.acting.size)).to(self.copies.simulation.device)
        found: Reward | None = None
        if not over.all():
            found, verdict = self._stepped(taken)
        if over.any():
            self._begin_anew(over)
        rewards = np.zeros(self.num_envs) if found is None else np.where(over, 0.0, found.reward.double().cpu().numpy())
        infos = {} if found is None else _infos(found, verdict, ~over)
        truncated = ~over & (self._age >= self.steps)
        self._over = truncated
        observed = self._observed()
        if self.mode == AutoresetMode.SAME_STEP and truncated.any():
            infos = {**infos, **_final(observed, infos, truncated)}
            self._begin_anew(truncated)
            self._over, observed = np.zeros(self.num_envs, bool), self._observed()
        return observed, rewards, np.zeros(self.num_envs, bool), truncated, infos

    def _stepped(self, actions: Tensor) -> tuple[Reward, Metrics]:
        """One step of all copies."""
        self._state = self.acting.act(self._state, actions)
        pose = self.acting.projection(self._state, None).pose
        light = self.copies.show(pose)
        disturbances = self.copies.simulation.scenario.disturbances
        frames = [Taken(seed, step, disturbances) for seed, step in zip(self._seeds, self._age.tolist(), strict=True)]
        self._looks.append(Look.of(self.copies.measured(light, frames), self.image))
        if len(self._looks) > self.late:
            came = torch.from_numpy((self._age >= self.late) & ~self._lost()).to(pose.device)
            self._seen = rows(came, self._looks.pop(0), self._nothing_seen())
        seen = replace(self._unseen(pose), code=self._seen.code, pose_error=self._seen.pose_error)
        self._state = self.acting.step(self._state, Observation(seen, None, Projection(ProjectionCommand(pose), ())))
        self._age = self._age + 1
        verdict = self.copies.judged(light)
        return reward(verdict, actions), verdict

    def _lost(self) -> Mask:
        """Copies whose frame that would arrive in this step is lost, `[num_envs]`."""
        scenario = self.copies.simulation.scenario
        if not (scenario.camera.drop_probability or scenario.disturbances.drops):
            return np.zeros(self.num_envs, bool)
        plant = world_plant(self.copies.simulation.plant, "an environment")
        taken = zip(self._seeds, (self._age - self.late).tolist(), strict=True)
        return np.array([step >= 0 and replace(plant, seed=seed).loses(step) for seed, step in taken])

    def _nothing_seen(self) -> Look:
        return Look.of(self._unseen(self.acting.projection(self._state, None).pose), self.image)

    def _unseen(self, pose: Tensor) -> Measurement:
        return self.copies.symbol.sensor.lost(pose, ExtractionStatus.NO_FRAME)

    def _begin_anew(self, which: Mask) -> None:
        symbol = self.copies.symbol
        pose = symbol.function.start_pose.pose.to(symbol.projector.target).expand(self.num_envs, 4)
        self._begin(which, self.acting.start(pose), self.np_random.integers(SEEDS, size=self.num_envs).tolist())

    def _begin(self, which: Mask, start: Any, seeds: Sequence[int]) -> None:
        """Reset the chosen copies to their rows of a state."""
        chosen = torch.from_numpy(which).to(self.copies.simulation.device)
        self._state = rows(chosen, start, self._state)
        self._seeds = [new if anew else old for anew, new, old in zip(which.tolist(), seeds, self._seeds, strict=True)]
        self._age, self._over = np.where(which, 0, self._age), self._over & ~which
        self._seen = rows(chosen, self._nothing_seen(), self._seen)

    def _observed(self) -> Any:
        return as_gymnasium(observation(self.acting.observed(self._state), self._seen, None), self._seen)


def _infos(found: Reward, verdict: Metrics, there: Mask) -> dict[str, Any]:
    """Infos of the copies that took a step, in Gymnasium's layout for vector environments: arrays, and masks of these copies."""
    tables = {"terms": found.terms, "verdict": vars(verdict)}
    told = {name: {key: value.cpu().numpy() for key, value in table.items()} for name, table in tables.items()}
    masked = {name: table | {f"_{key}": there for key in table} for name, table in told.items()}
    return masked | {f"_{name}": there for name in masked}


def _final(observed: Any, infos: dict[str, Any], over: Mask) -> dict[str, Any]:
    """Last observations and infos of the episodes that end in this step."""
    last = np.full(len(over), None, dtype=object)
    for k in np.flatnonzero(over):
        last[k] = {key: value[k] for key, value in observed.items()} if isinstance(observed, dict) else observed[k]
    return {"final_obs": last, "_final_obs": over, "final_info": infos, "_final_info": over}
