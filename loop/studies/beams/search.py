"""Searches for beam patterns: gradient descent through lamps, scene, camera and network, or sampling (T fig. 9.3)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import optuna
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from luxloop.loop.studies.beams.goal import BeamJudge

RATE = 0.02  # of Adam, in utilisation a step at most or so
START = 0.1  # utilisation of all pixels where the scenario has no base beam
PATCHES = (3, 8)  # rows and columns of patches of light for sampling
Lights = tuple[Tensor, ...]


@dataclass(frozen=True, eq=False)
class Found:
    """Utilisations `[n_p]`, one a module, and the loss of every step or trial."""

    lights: Lights
    losses: tuple[float, ...]


def begin(judge: BeamJudge) -> Lights:
    """The scenario's base beam, or all pixels at START if it is off."""
    simulation = judge.simulation
    plan = simulation.planner.plan(simulation.situation(0.0))
    base = tuple(module.base(plan).float() for module in simulation.modules)
    return base if any(bool(u.any()) for u in base) else tuple(torch.full_like(u, START) for u in base)


def descend(judge: BeamJudge, start: Lights, steps: int, on_step: Callable[[int, float], None] = lambda step, loss: None) -> Found:
    """Adam on the utilisations of all pixels, held within 0..1; every step has a noise of its own."""
    lights = [u.clone().requires_grad_(True) for u in start]
    optimiser, losses = torch.optim.Adam(lights, RATE, betas=(0.9, 0.99)), []
    for step in range(steps):
        optimiser.zero_grad()
        loss = judge.judged(lights, step).loss
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        with torch.no_grad():
            for u in lights:
                u.clamp_(0, 1)
        losses.append(loss.item())
        on_step(step, losses[-1])
    return Found(tuple(u.detach() for u in lights), tuple(losses))


def sample(judge: BeamJudge, start: Lights, trials: int, on_step: Callable[[int, float], None] = lambda step, loss: None) -> Found:
    """Optuna's tree-structured Parzen estimator on the levels of the start and of a few patches of light, for any detector."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=judge.simulation.scenario.seed, multivariate=True))
    names = [f"patch {row} {column}" for row in range(PATCHES[0]) for column in range(PATCHES[1])]
    study.enqueue_trial(dict.fromkeys(names, 0.0) | {"start": 1.0})
    losses = []

    def lights_of(levels: dict[str, float]) -> Lights:
        patches = torch.tensor([levels[name] for name in names]).view(PATCHES)
        return tuple(
            (levels["start"] * u + _on_pixels(patches, module.headlight.pixel_rows, module.headlight.pixel_cols).to(u)).clamp(0, 1)
            for u, module in zip(start, judge.simulation.modules, strict=True)
        )

    for number in range(trials):
        trial = study.ask()
        levels = {name: trial.suggest_float(name, 0.0, 1.0) for name in (*names, "start")}
        with torch.no_grad():
            losses.append(float(judge.judged(lights_of(levels), number).loss))
        study.tell(trial, losses[-1])
        on_step(number, losses[-1])
    return Found(lights_of(study.best_params), tuple(losses))


def _on_pixels(patches: Tensor, rows: int, columns: int) -> Tensor:
    return interpolate(patches[None, None], (rows, columns), mode="bilinear")[0, 0].flatten()


def alike(lights: Sequence[Tensor], flux: Sequence[Tensor], lm: float) -> Lights:
    """The beam scaled to a luminous flux in lm: utilisations `[n_p]` of each module, limited to 1."""
    total = float(sum((u * f).sum() for u, f in zip(lights, flux, strict=True)))
    return tuple((u * (lm / max(total, 1e-9))).clamp(max=1) for u in lights)
