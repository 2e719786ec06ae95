"""A closed loop as a Gymnasium environment, on the whole simulation: bounded observations, reward by the evaluator."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces
from gymnasium.utils import EzPickle
from torch import Tensor
from torch.nn.functional import interpolate

from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.loop.report.picture import frame_picture, white_of
from luxloop.loop.run import torch_device
from luxloop.loop.scenario.edits import with_overrides
from luxloop.loop.scenario.model import Scenario, load, only
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.result import SimulationState
from luxloop.loop.simulation.simulated import world_plant
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.environment.acting import ACTIONS, Acting, Heights
from luxloop.perception.appearance import DEGREES
from luxloop.perception.egomotion import Ego
from luxloop.perception.extraction import ExtractionStatus
from luxloop.perception.metrics import Metrics
from luxloop.world.errors import LuxloopError, did_you_mean

Floats = npt.NDArray[np.float32]

ERRORS = (20.0, 10.0, 0.5, 0.5)  # m, m, rad, rad: limits of observed errors
AREA = 4.0
MOTION = (100.0, 3.0)  # m/s, rad/s
CENTROID_WEIGHT, ACTION_WEIGHT = 0.5, 0.01
SUCCESS = 0.05  # distance of the centroids relative to the symbol's size, up to which a symbol is at its target


def action_of(given: Any, shape: tuple[int, ...]) -> Tensor:
    """Action `[..., n]`, limited to -1..1. Raises LuxloopError for another shape, or values that are not finite."""
    taken = torch.as_tensor(np.asarray(given, np.float32))
    if taken.shape != shape or not bool(taken.isfinite().all()):
        raise LuxloopError(f"step: an action has the shape {shape} and finite numbers, not {tuple(taken.shape)} or NaN; see action_space")
    return taken.clamp(-1, 1)


def reward_terms(metrics: Metrics, action: Tensor) -> dict[str, Tensor]:
    """Terms `[...]` of the reward of an action `[..., n]`, which is their sum. metrics: of the symbol after the action.

    iou: overlap of the symbol with its target on the road, 0..1. centroid: -0.5 times the distance of their centroids relative to the
    symbol's length and width, at most 1. action: -0.01 times the mean square of the action. If nothing is lit, iou is 0 and centroid -0.5.
    """
    away = centroid_distance(metrics).clamp(max=1.0)
    return {
        "iou": metrics.iou.nan_to_num(0.0),
        "centroid": -CENTROID_WEIGHT * away,
        "action": -ACTION_WEIGHT * action.square().mean(-1).to(away),
    }


def centroid_distance(metrics: Metrics) -> Tensor:
    """Distance `[...]` of the symbol's centroid from its target's, relative to the symbol's length and width; 1 if nothing is lit."""
    return (metrics.centroid_percent / 100).norm(dim=-1).nan_to_num(1.0)


def bounds(acting: Acting) -> tuple[Floats, Floats]:
    """Smallest and largest values of an observation, `[n]` each."""
    low, high = (each.cpu().tolist() for each in acting.limits)
    least = [*low, *(-each for each in ERRORS), *[0.0] * len(ExtractionStatus), 0.0, 0.0, -MOTION[1]]
    most = [*high, *ERRORS, *[1.0] * len(ExtractionStatus), AREA, *MOTION]
    return np.array(least, np.float32), np.array(most, np.float32)


@dataclass(frozen=True)
class Look:
    """Observed part of a measurement of the newest frames.

    code: `[...]` int64, an `ExtractionStatus`. pose_error: `[..., 4]` m, m, rad, rad, 0 if the symbol is lost. area_ratio: `[...]`,
    measured over expected. image: `[..., h, w]` uint8, the extracted symbol, scaled; None if observations have no image.
    """

    code: Tensor
    pose_error: Tensor
    area_ratio: Tensor
    image: Tensor | None

    @classmethod
    def of(cls, seen: Measurement, size: tuple[int, int] | None) -> "Look":
        """Observed part of a measurement. size: rows and columns of the image, None for no image."""
        usable = (seen.code == ExtractionStatus.SEEN) & seen.pose_error.isfinite().all(-1)
        most = seen.pose_error.new_tensor(ERRORS)
        errors = torch.where(usable[..., None], seen.pose_error, 0.0).clamp(-most, most)
        area = torch.where(usable, seen.area_ratio, 0.0).nan_to_num(0.0).clamp(0, AREA)
        return cls(seen.code, errors, area, None if size is None else _scale(seen.symbol, size))


def observation(state: Tensor, look: Look, ego: Ego | None) -> Tensor:
    """Observation `[..., n]`, see `SymbolEnv`. state: `[..., k]`, observed part of a controller's state. ego: None for a standing car."""
    codes = torch.nn.functional.one_hot(look.code, len(ExtractionStatus)).to(state)
    moving = state.new_zeros(2) if ego is None or ego.stands else torch.stack([ego.speed_m_s, ego.yaw_rate_rad_s]).to(state)
    motion = moving.clamp(state.new_tensor([0.0, -MOTION[1]]), state.new_tensor(MOTION)).expand(*state.shape[:-1], 2)
    return torch.cat([state, look.pose_error, codes, look.area_ratio[..., None], motion], -1)


def as_gymnasium(vector: Tensor, look: Look) -> Any:
    """Observation as NumPy arrays for Gymnasium: the vector, or a dictionary of state and image."""
    state = vector.float().cpu().numpy()
    return state if look.image is None else {"state": state, "image": look.image.cpu().numpy()}


def _scale(symbol: Tensor, size: tuple[int, int]) -> Tensor:
    """Symbol image `[..., h, w]` in 0..1, scaled to `[..., *size]` uint8."""
    if not symbol.numel():
        return torch.zeros((*symbol.shape[:-2], *size), dtype=torch.uint8, device=symbol.device)
    scaled = interpolate(symbol.reshape(-1, 1, *symbol.shape[-2:]), size, mode="bilinear", align_corners=False, antialias=True)
    return (255 * scaled).round().clamp(0, 255).byte().reshape(*symbol.shape[:-2], *size)


FPS = 10
SEEDS = 2**63


class SymbolEnv(gymnasium.Env[Any, Floats], EzPickle):
    """A scenario with exactly one held symbol, whose controller the agent replaces.

    An observation is float32:

    | at | what | unit | sign | within |
    | --- | --- | --- | --- | --- |
    | 0, 1 | x, y of the projected primitive | m | ahead, to the left | range of the controller |
    | 2, 3 | its roll, pitch | rad | right side down, nose down | range of the controller |
    | 4, 5 | measured error of x, y, 0 if the symbol is lost | m | too far, too far left | 20, 10 |
    | 6, 7 | measured error of roll, pitch | rad | as 2, 3 | 0.5 |
    | 8 to 13 | one-hot `luxloop.ExtractionStatus`, at 8 if the symbol is seen | 1 | | 0 to 1 |
    | 14 | measured area over expected area | 1 | | 0 to 4 |
    | 15, 16 | speed, yaw rate of the car | m/s, rad/s | ahead, to the left | 100, 3 |

    With the action "heights", the 32 heights in m replace 0 to 3. With `image`, an observation is `{"state": the vector, "image": [h, w]
    uint8}`; the image is the extracted symbol, cropped and scaled. Errors are those of the newest frame that has arrived; with latency it
    was taken some steps ago.

    Actions are float32 in -1..1. "moves" `[4]`: moves of x, y, roll, pitch; 1 is the controller's largest move in a step. "gains" `[6]`:
    kp, ki, kd of position, then of rotation, are multiplied by 4 ** action. "heights" `[32]`: changes of the assumed road heights, 8 rows
    from far to near with 4 cells from left to right; 1 is 3 cm.

    The reward is the sum of `reward_terms`, which are in `info["terms"]`; `info["verdict"]` has the symbol's metrics, `info["is_success"]`
    whether the centroids are within 5 % of the symbol's size. An episode is truncated after the scenario's steps and never terminates
    before. `reset(seed=n)` draws the noise of seed n in the same world, without a seed another noise; its info has the "seed".
    `options={"start": [x, y, roll, pitch]}` sets the start pose (m, rad) within the range of the controller, except with "heights". A
    copied or unpickled environment is made from the same arguments: call `reset` next.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": FPS}  # noqa: RUF012 (Gymnasium's name)

    def __init__(
        self,
        scenario: Scenario | str | Path,
        overrides: Sequence[str] = (),
        *,
        action: str = "moves",
        image: tuple[int, int] | None = None,
        render_mode: Literal["rgb_array", "human"] | None = None,
        device: str = "cpu",
    ) -> None:
        """scenario: a loaded scenario, or a name or path. overrides: changes of its keys, as KEY=VALUE. action: "moves", "gains" or
        "heights". image: rows and columns of the image in observations. render_mode: as for `make`. device: "cpu" or "cuda".

        Raises LuxloopError for a value that does not exist, if the scenario has not exactly one held symbol, or if its plant does not know
        the truth.
        """
        EzPickle.__init__(self, scenario, overrides, action=action, image=image, render_mode=render_mode, device=device)
        self.scenario = with_overrides(load(str(scenario)) if isinstance(scenario, str | Path) else scenario, [*overrides, "judge_every=1"])
        if action not in ACTIONS:
            raise LuxloopError(f"action: there is no {action!r}; {did_you_mean(action, ACTIONS)}")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise LuxloopError(f"render_mode: there is no {render_mode!r}; {did_you_mean(str(render_mode), self.metadata['render_modes'])}")
        if image is not None and (len(image) != 2 or min(image) < 1):
            raise LuxloopError(f"image: {image!r} is no size; give its rows and columns, such as (24, 48)")
        self.render_mode, self.image, self._device, self._action = render_mode, image, torch_device(device), action
        self._simulation: Simulation | None = None
        self.prepare({})
        low, high = bounds(self.acting)
        state = spaces.Box(low, high, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (self.acting.size,), np.float32)
        self.observation_space = state if image is None else spaces.Dict({"state": state, "image": spaces.Box(0, 255, image, np.uint8)})
        self._state: SimulationState | None = None
        self._result: Evaluation | None = None
        self._white: torch.Tensor | None = None

    def prepare(self, values: dict[str, float | int]) -> None:
        """Change values of the scenario's keys and prepare only what they affect; call `reset` next."""
        scenario = with_overrides(self.scenario, [f"{key}={value!r}" for key, value in values.items()])
        prepared = Simulation.prepare(scenario, self._device, self._simulation)
        world_plant(prepared.plant, "an environment")
        symbol = prepared.symbol
        sensor = replace(symbol.sensor, searches=False)
        self.acting = ACTIONS[self._action](sensor, symbol.params)
        held = replace(symbol, sensor=sensor, controller=self.acting)
        self._simulation = prepared
        self.simulation = replace(prepared, controlled={only(prepared.controlled): held})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        check_options(options, "start")
        super().reset(seed=seed)
        noise_seed = int(self.np_random.integers(SEEDS)) if seed is None else seed
        simulation = self.simulation
        plant = replace(world_plant(simulation.plant, "an environment"), seed=noise_seed)
        scenario = simulation.scenario.model_copy(update={"seed": noise_seed})
        self.simulation = replace(simulation, scenario=scenario, plant=plant)
        state, symbol = self.simulation.start(), self.simulation.symbol
        pose = start_of(options, self.acting, symbol.function.start_pose.pose, (4,)).to(symbol.projector.target)
        ((name, held),) = state.symbols.items()
        self._state = replace(state, symbols={name: replace(held, controller=self.acting.start(pose))})
        self._result = None
        return self._observation(None), {"seed": noise_seed}

    def step(self, action: Floats) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        if self._state is None:
            raise LuxloopError("step: there is no episode; call reset() first")
        if self._state.step >= self.simulation.scenario.steps:
            raise LuxloopError("step: the episode is over; call reset() first")
        ((name, held),) = self._state.symbols.items()
        taken = action_of(action, (self.acting.size,)).to(self.simulation.device)
        acted = replace(held, controller=self.acting.act(held.controller, taken))
        self._state, result = self.simulation.step(replace(self._state, symbols={name: acted}))
        self._result = evaluated = self.simulation.evaluate(result)
        metrics = evaluated.symbol.metrics
        assert metrics is not None
        terms = reward_terms(metrics, taken)
        info = {
            "terms": {key: float(value) for key, value in terms.items()},
            "verdict": {key: value.cpu().numpy() for key, value in vars(metrics).items()},
            "is_success": bool(centroid_distance(metrics) <= SUCCESS),
        }
        truncated = self._state.step >= self.simulation.scenario.steps
        if self.render_mode == "human":
            self._show()
        return self._observation(result.measurement), float(sum(terms.values())), False, truncated, info

    def render(self) -> Any:
        """The camera's view as in a run's video, `[height, width, 3]` uint8, black before the first step; None with render_mode "human"."""
        if self.render_mode == "human":
            self._show()
            return None
        return self._picture()

    def close(self) -> None:
        self._state = None
        if self.render_mode == "human":
            from matplotlib import pyplot

            pyplot.close(f"luxloop: {self.scenario.name}")

    def _picture(self) -> Any:
        if self._result is None:
            camera = self.scenario.camera
            return np.zeros((camera.height_px, camera.width_px, 3), np.uint8)
        if self._white is None:
            self._white = white_of(self._result, self.simulation)
        return frame_picture(self._result, self.simulation, self._white)

    def _show(self) -> None:
        from matplotlib import pyplot

        figure = pyplot.figure(f"luxloop: {self.scenario.name}")
        figure.clear()
        figure.add_axes((0, 0, 1, 1)).imshow(self._picture())
        pyplot.pause(1e-3)

    def _observation(self, seen: Measurement | None) -> Any:
        assert self._state is not None
        ((_, held),) = self._state.symbols.items()
        ego = self.simulation.ego(self._state.samples, self._state.arrivals.time_s)
        if seen is None:
            seen = self.simulation.symbol.sensor.lost(self.acting.projection(held.controller, ego).pose, ExtractionStatus.NO_FRAME)
        look = Look.of(seen, self.image)
        return as_gymnasium(observation(self.acting.observation(held.controller), look, ego), look)


def check_options(options: dict[str, Any] | None, *known: str) -> None:
    """Raise LuxloopError for unknown options of `reset`."""
    if others := [key for key in options or {} if key not in known]:
        raise LuxloopError(f"reset: options[{others[0]!r}]: there is no such option; {did_you_mean(others[0], known)}")


def start_of(options: dict[str, Any] | None, acting: Acting, pose: torch.Tensor, *shapes: tuple[int, ...]) -> torch.Tensor:
    """Start pose in `options`, by default `pose` `[4]`.

    Raises LuxloopError for other shapes, values that are not finite or out of the controller's range, or actions without a pose.
    """
    given = (options or {}).get("start")
    if given is None:
        return pose
    if isinstance(acting, Heights):
        raise LuxloopError(
            "reset: options['start']: the action 'heights' draws the symbol at its target; leave it out, or take moves or gains"
        )
    start = torch.as_tensor(np.asarray(given, np.float32))
    if start.shape not in shapes or not bool(start.isfinite().all()):
        wanted = " or ".join(map(str, shapes))
        raise LuxloopError(f"reset: options['start']: is no pose; give x and y in m, roll and pitch in rad, in the shape {wanted}")
    low, high = (each.cpu() for each in acting.limits)
    if bool(((start < low) | (start > high)).any()):
        ranges = ", ".join(f"{each.name} {least:.3g} to {most:.3g}" for each, least, most in zip(DEGREES, low, high, strict=True))
        raise LuxloopError(f"reset: options['start']: is out of the controller's range; give {ranges}, in m and rad")
    return start
