"""Stability margins of thesis_pid: the linear plant identified on the simulated one, closed with the law and the camera's latency.

A loop is `L(z) = g z^-(latency + 1) C(z)` with the incremental law `C(z) = (kp + ki z / (z - 1) + kd (z - 1) / z) z / (z - 1)`; g is a
diagonal element of the plant `[4, 4]`, the derivative of the pose errors by the pose. Margins are those of python-control.
"""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import control
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.controllers.pid import PidGains
from luxloop.controllers.symbol.feedback import ThesisPid, ThesisPidParams
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.studies.batch.copies import Conditions, Copies
from luxloop.loop.studies.runs import kind, ready, with_controllers
from luxloop.loop.studies.tune import PLANTS
from luxloop.perception.appearance import DEGREES, probes
from luxloop.perception.extraction import ExtractionStatus

LOOPS = tuple(degree.name for degree in DEGREES)
NEWTON_STEPS = 2  # from the target to the pose at which the errors vanish
NEAR = 0.5  # of the sensor's probes: over 1 deg the gain of roll is 0.99, near the target 1.2, and this decides the margin
LARGEST_GAIN = 100.0  # to which a coupled loop's gain is raised
FREQUENCIES = 2000  # to the Nyquist frequency
CLOSE = 1e-3  # relative accuracy of its gain margin


@dataclass(frozen=True)
class Margins:
    """Margins of a loop: factor on its gain and phase in deg at which it oscillates, largest sensitivity |1 / (1 + L)|, and the frequency
    in Hz up to which it is below -3 dB.

    An unstable loop has the gain margin 0, and no others (NaN).
    """

    gain: float
    phase_deg: float = math.nan
    sensitivity: float = math.nan
    bandwidth_hz: float = math.nan


@dataclass(frozen=True)
class LinearLoops:
    """thesis_pid on its linear plant. plant: `[4, 4]`. gains: of the law. latency_steps: of the frames. rate_hz: of control."""

    plant: NDArray[np.float64]
    gains: PidGains
    latency_steps: int
    rate_hz: float

    @classmethod
    def of(cls, scenario: Scenario, plant: NDArray[np.float64]) -> "LinearLoops":
        """The loops of a scenario on a plant (`identify`)."""
        late, params = scenario.camera.latency_steps, scenario.symbol.controller
        assert isinstance(params, ThesisPidParams)
        law = ThesisPid.prepare(params, scenario.symbol.start_pose.pose.double())
        return cls(plant, law.gains_at(late), late, scenario.rate_hz)

    def open_loops(self, gain: float = 1.0, late: int = 0) -> list[control.TransferFunction]:
        """L of each loop. gain: factor on the plant. late: additional steps of latency."""
        z = control.tf([1, 0], [1], 1.0 / self.rate_hz)
        kp, ki, kd = (getattr(self.gains, name).tolist() for name in ("kp", "ki", "kd"))
        law = [(p + (i * z / (z - 1) if i else 0) + d * (z - 1) / z) * z / (z - 1) for p, i, d in zip(kp, ki, kd, strict=True)]
        return [gain * g * each / z ** (self.latency_steps + late + 1) for g, each in zip(np.diag(self.plant), law, strict=True)]

    def margins(self) -> dict[str, Margins]:
        """Margins of each loop alone, by name, and the gain margin of all loops, coupled by the whole plant."""
        loops = self.open_loops()
        found = {name: _margins(loop, self.rate_hz) for name, loop in zip(LOOPS, loops, strict=True)}
        return {**found, "coupled": Margins(_gain_margin(loops, self.plant / np.diag(self.plant)))}

    def step_responses(self, steps: int) -> NDArray[np.float64]:
        """Error of each loop after a unit step of the road, on each of the `PLANTS`: `[plants, 4, steps]`."""
        times = np.arange(steps) / self.rate_hz
        return np.array(
            [[control.step_response(1 / (1 + loop), times).outputs for loop in self.open_loops(gain, late)] for gain, late in PLANTS]
        )


def _margins(loop: control.TransferFunction, rate_hz: float) -> Margins:
    if (gain := _gain_margin([loop], np.eye(1))) == 0:
        return Margins(gain)
    hz = np.linspace(0, rate_hz / 2, FREQUENCIES)[1:]
    sensitivity = abs(1 / (1 + loop(np.exp(1j * math.tau * hz / rate_hz))))
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # it evaluates the pole at 1
        _, phases, *_ = control.stability_margins(loop, returnall=True)
    return Margins(
        gain, float(np.abs(phases).min(initial=180.0)), float(sensitivity.max()), float(hz[np.argmax(sensitivity > math.sqrt(0.5))])
    )


def _gain_margin(loops: Sequence[control.TransferFunction], coupling: NDArray[np.float64]) -> float:
    """Factor on the gains of n loops at which an eigenvalue of their closed loop leaves the unit circle; 0 if one lies outside.

    coupling: `[n, n]`, output of each loop by the input of each. python-control finds no crossing at the Nyquist frequency.
    """
    open_loop = control.append(*map(control.ss, loops))

    def stable(gain: float) -> bool:
        closed = open_loop.A - gain * open_loop.B @ coupling @ open_loop.C
        return bool(np.abs(np.linalg.eigvals(closed)).max() < 1)

    low, high = 1.0, LARGEST_GAIN
    if not stable(low):
        return 0.0
    while high > low * (1 + CLOSE):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def identify(scenario: Scenario, device: str = "cpu") -> NDArray[np.float64] | None:
    """Plant `[4, 4]` of a scenario with thesis_pid: derivative of the noise-free pose errors (m, rad) by the pose, by central differences
    about the pose at which the errors vanish. None where no batch can run, or the symbol is not seen there.
    """
    if not isinstance(scenario.symbol.controller, ThesisPidParams) or kind(scenario) is None:
        return None
    simulation = ready(scenario, device)
    quiet = scenario.model_copy(update={"camera": scenario.camera.model_copy(update={"noise": False})})
    copies = Copies(with_controllers(simulation, quiet))
    pose = simulation.symbol.projector.target
    probe = NEAR * probes(pose)
    for _ in range(NEWTON_STEPS):
        errors = _errors(copies, torch.cat([pose + probe, pose - probe, pose[None]]))
        if errors is None:
            return None
        ahead, behind, at = errors.split([len(probe), len(probe), 1])
        plant = ((ahead - behind) / (2 * probe.sum(-1, keepdim=True))).T.double()
        pose = pose - torch.linalg.solve(plant, at[0].double()).to(pose)
    found: NDArray[np.float64] = plant.cpu().numpy()
    return found


def _errors(copies: Copies, poses: Tensor) -> Tensor | None:
    """Pose errors `[B, 4]` of poses `[B, 4]`; None where a symbol is not seen."""
    seen = copies.measure(copies.show(poses), [Conditions(0, 0)] * len(poses))
    return torch.stack([each.pose_error for each in seen]) if all(each.code == ExtractionStatus.SEEN for each in seen) else None


def worst(margins: Sequence[dict[str, Margins]]) -> dict[str, Margins]:
    """The worst margins of several plants, by loop; NaN where one has none."""
    picks = {"gain": np.min, "phase_deg": np.min, "sensitivity": np.max, "bandwidth_hz": np.min}
    return {
        name: Margins(*(float(pick([getattr(each[name], key) for each in margins])) for key, pick in picks.items())) for name in margins[0]
    }
