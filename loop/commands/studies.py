"""The commands that do many runs: evaluate, campaign, tune, optimise-beam, train-detector."""

import shlex
from pathlib import Path
from typing import Literal

from loop.terminal.options import DIFFERS, OK, AllowCode, Device, Keys, with_controller


def evaluate(
    *,
    quick: bool = False,
    lamp: Literal["hd84", "ssl-hd-lores"] | None = None,
    out: Path = Path("runs/evaluation"),
    jobs: int | None = None,
) -> int:
    """Judge MapReduce control by the joint optimum of all pixels, over rectangles in five degrees of freedom; exit code 1 if jobs failed.

    Parameters
    ----------
    quick
        Take 45 of the 1,215 rectangles, evenly spread, and coarser sensitivities: minutes in place of an hour.
    lamp
        Lamp to evaluate, by default both.
    out
        Folder for results, figures and report.md; a run that was stopped goes on from what is there.
    jobs
        Processes, each with one thread; by default one a core.
    """
    from loop.evaluation.report import run_evaluation

    return OK if run_evaluation(out, lamp, quick, jobs) else DIFFERS


def campaign(
    file: Path,
    /,
    *,
    out: Path | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    device: Device = "auto",
    allow_code: AllowCode = False,
) -> int:
    """Run a grid of scenarios, controllers, variants and seeds into one table with a report; exit code 1 if runs failed.

    Parameters
    ----------
    file
        TOML file of the campaign (see docs/campaigns.md).
    out
        Folder for table and report, by default runs/FILE; a campaign that was stopped goes on from what is there.
    jobs
        Processes, each with one thread; by default one a core.
    scheduler
        Address of a Dask scheduler whose workers do the runs, such as tcp://localhost:8786.
    device
        Where to compute; auto takes CUDA where there is any.
    """
    from loop.studies.campaign_report import do_campaign

    return OK if do_campaign(file, out, jobs, scheduler, device, allow_code) else DIFFERS


def tune(
    names: list[str],
    /,
    *,
    key: Keys = None,
    objective: str = "settling+residual",
    trials: int = 50,
    seeds: int = 1,
    seed: int = 0,
    controller: str | None = None,
    set: Keys = None,
    out: Path | None = None,
    jobs: int | None = None,
    device: Device = "auto",
    gradient: bool = False,
    allow_code: AllowCode = False,
) -> None:
    """Look for better values of a scenario's keys, such as a controller's gains; what is best becomes a file for --set.

    Parameters
    ----------
    names
        Scenario files, or names of shipped scenarios; a trial runs all of them.
    key
        Keys to tune and their ranges, as key=low:high or key=low:high:log, such as functions.symbol.controller.position.kp=0.1:2.
    objective
        What to minimise: settling, overshoot, residual, iou and energy, weighted as in settling+0.5*overshoot.
    trials
        Total number of trials, earlier ones included.
    seeds
        Runs of each scenario a trial, which differ in their noise.
    seed
        Seed of the search.
    controller
        Controller to take in all scenarios, with its defaults (see `luxloop list controllers`).
    set
        Keys to change in all scenarios, as key=value in TOML syntax, or a TOML file of them.
    out
        Folder for the study, the best values and the report, by default runs/tune-NAME; a study that was stopped goes on from there.
    jobs
        Processes for the runs of a trial, each with one thread; by default one a core. Their number does not change the result.
    device
        Where to compute; auto takes CUDA where there is any.
    gradient
        Gradient descent through differentiable runs, a trial an iteration; for gains and rate limits of thesis_pid where nothing moves.
    """
    from loop import objective as objectives
    from loop.run import torch_device
    from loop.scenario.model import load
    from loop.studies import ranges
    from loop.studies.tune import Task
    from loop.studies.tune_report import do_tune

    scenarios = tuple(load(name, set or [], allow_code=allow_code, **with_controller(controller)) for name in names)
    tuned = tuple(ranges.parse(each, scenarios) for each in key or [])
    task = Task(scenarios, tuned, objectives.parse(objective), seeds, seed, str(torch_device(device)))
    taken = "" if controller is None else f" --controller {controller}"
    do_tune(task, out or Path("runs") / f"tune-{scenarios[0].name}", trials, jobs, gradient, f"{names[0]}{taken}")


def optimise_beam(
    name: str,
    /,
    *,
    metric: Literal["detector", "weber_contrast", "edges"] = "detector",
    energy: float = 2.0,
    unevenness: float = 0.0,
    glare: float = 0.1,
    method: Literal["auto", "gradient", "sampling"] = "auto",
    steps: int | None = None,
    set: Keys = None,
    out: Path | None = None,
    device: Device = "auto",
    allow_code: AllowCode = False,
) -> None:
    """Look for the utilisation of every pixel by which objects are detected best with little light, at a scenario's first moment.

    Parameters
    ----------
    name
        Scenario file, or name of a shipped scenario; its base beam is the start, and its functions are left out.
    metric
        What to maximise on the objects: a detector's confidence, their Weber contrast, or the steepness of their edges.
    energy
        Weight of the lamps' flux, as a share of all pixels on, beside the logarithm of the metric.
    unevenness
        Weight of standard deviation over mean of the light on objects.
    glare
        Weight of light on heads and windscreens, for each lx over 1 lx.
    method
        Gradient descent over all pixels, for the network and the metrics, or sampling of a few patches of light, for any detector.
    steps
        Steps of the search; by default 80 of descent, 150 of sampling.
    set
        Keys to change in the scenario, as key=value in TOML syntax, or a TOML file of them.
    out
        Folder for utilisations, raw.toml that plays them by --set, picture and figures, by default runs/beam-NAME.
    device
        Where to compute; auto takes CUDA where there is any.
    """
    from loop.beams.optimise import optimise_beam
    from loop.scenario.model import load

    goal = {"metric": metric, "energy": energy, "unevenness": unevenness, "glare": glare}
    scenario, played_by = load(name, set or [], allow_code=allow_code), shlex.join([name, "--set", *(set or [])])
    optimise_beam(scenario, goal, method, steps, out or Path("runs") / f"beam-{Path(name).stem}", device, played_by)


def train_detector(
    *,
    out: Path = Path("runs/detector"),
    scenes: int = 600,
    held_out: int = 100,
    epochs: int = 68,
    seed: int = 0,
    jobs: int | None = None,
) -> None:
    """Train luxloop's own detector on well-lit scenes, and judge it on others: weights, report and picture.

    Parameters
    ----------
    out
        Folder for scenes, weights and report; scenes that are there are not drawn again.
    scenes
        Scenes to train on, 2 MB each.
    held_out
        Scenes to judge it on.
    epochs
        How often it sees each scene, each time in other light and with other objects.
    seed
        Seed of weights, light and noise.
    jobs
        Processes that draw scenes; by default one a core.
    """
    from loop.training.train import train_detector

    train_detector(out, scenes, held_out, epochs, seed, jobs)
