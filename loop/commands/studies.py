"""The commands with many runs or of detectors: evaluate, campaign, dataset, tune, optimise-beam, train-detector, detect."""

import shlex
from pathlib import Path
from typing import Annotated, Literal

from luxloop.loop.commands.options import DIFFERS, OK, AllowCode, Count, Device, Keys, Seed, Weight, scenario_of, within
from luxloop.loop.report import terminal as tables

CLASSES = 6  # named in the closing line of a data set


def evaluate(
    *,
    quick: bool = False,
    lamp: Literal["hd84", "ssl-hd-lores"] | None = None,
    out: Path = Path("runs/evaluation"),
    jobs: Count | None = None,
) -> int:
    """Compare MapReduce control with the joint optimum of all pixels, over rectangles in five degrees of freedom; exit code 1 if jobs
    failed.

    Parameters
    ----------
    quick
        Take 45 of the 1,215 rectangles, evenly spread, and coarser sensitivities: minutes instead of an hour.
    lamp
        Lamp to evaluate; by default both.
    out
        Folder for results, figures and report.md; an interrupted run continues from there.
    jobs
        Processes, each with one thread; by default one per core.
    """
    from luxloop.loop.studies.evaluation.report import run_evaluation

    return OK if run_evaluation(out, lamp, quick, jobs) else DIFFERS


def campaign(
    file: Path,
    /,
    *,
    out: Path | None = None,
    jobs: Count | None = None,
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
        Folder for table and report, by default runs/FILE; an interrupted campaign continues from there.
    jobs
        Processes, each with one thread; by default one per core.
    scheduler
        Address of a Dask scheduler whose workers run the scenarios, such as tcp://localhost:8786.
    device
        Device to compute on; auto takes CUDA if available.
    """
    from luxloop.loop.studies import campaign_report

    folder = out or Path("runs") / file.stem
    found = campaign_report.campaign(file, folder, jobs=jobs, scheduler=scheduler, device=device, allow_code=allow_code)
    for key, reason in found.failures.items():
        tables.say(f"failed: {key}: {reason}", stderr=True)
    tables.show(campaign_report.overview(found))
    print(f"{folder / campaign_report.TABLE} and {folder / campaign_report.REPORT} written")
    return DIFFERS if found.failures else OK


def dataset(
    file: Path,
    /,
    *,
    scenes: Count = 100,
    out: Path | None = None,
    jobs: Count | None = None,
    allow_code: AllowCode = False,
) -> int:
    """Make a data set of night scenes with labels, from seeds; exit code 1 if scenes failed.

    Parameters
    ----------
    file
        TOML file of the data set (see docs/data.md).
    scenes
        Number of scenes; scenes that the folder has already are not made again.
    out
        Folder for scenes and labels, by default runs/FILE; an interrupted data set continues from there.
    jobs
        Processes, each with one thread; by default one per core.
    """
    from luxloop.loop.studies.training.dataset import make_dataset, read

    counts, failures = make_dataset(read(file, scenes, allow_code=allow_code), out or Path("runs") / file.stem, jobs)
    for key, reason in failures.items():
        tables.say(f"failed: scene {key}: {reason}", stderr=True)
    objects = ", ".join(f"{number:,} {name}" for name, number in counts.objects.most_common(CLASSES))
    found = f"{tables.plural(counts.scenes, 'scene')}, {tables.plural(counts.frames, 'frame')}, objects: {objects or 'none'}"
    print(f"{', '.join(map(str, counts.files))} written: {found}")
    return DIFFERS if failures else OK


def tune(
    names: list[str],
    /,
    *,
    key: Keys = None,
    objective: str = "settling+residual",
    trials: Count = 50,
    seeds: Count = 1,
    seed: int = 0,
    controller: str | None = None,
    set: Keys = None,
    out: Path | None = None,
    jobs: Count | None = None,
    device: Device = "auto",
    gradient: bool = False,
    robust: bool = False,
    allow_code: AllowCode = False,
) -> None:
    """Tune keys of a scenario, such as a controller's gains, and write the best values as a file for --set.

    Parameters
    ----------
    names
        Scenario files, or names of shipped scenarios; each trial runs all of them.
    key
        Keys to tune and their ranges, as key=low:high or key=low:high:log, such as functions.symbol.controller.position.kp=0.1:2.
    objective
        What to minimise: settling, overshoot, residual, iou, effort and energy, weighted as in settling+0.5*overshoot.
    trials
        Total number of trials, earlier ones included.
    seeds
        Runs of each scenario per trial, which differ in their noise.
    seed
        Seed of the search.
    controller
        Controller to use in all scenarios, with its defaults (see `luxloop list controllers`).
    set
        Keys to change in all scenarios, as key=value in TOML syntax, or a TOML file of them.
    out
        Folder for study, best values and report, by default runs/tune-NAME; an interrupted study continues from there.
    jobs
        Processes for the runs of a trial, each with one thread; by default one per core. Their number does not change the result.
    device
        Device to compute on; auto takes CUDA if available.
    gradient
        Use gradient descent on predictions learned from the runs, one trial per iteration; for gains and rate limits of thesis_pid where
        nothing moves.
    robust
        Also run each trial with 0.8 and 1.25 times the plant's gain, and with one more step of latency; the cost is the mean of their mean
        and their worst. For thesis_pid.
    """
    scenarios = tuple(scenario_of(name, set, controller, allow_code=allow_code) for name in names)
    from luxloop.loop.studies.tune_report import do_tune, task_of

    task = task_of(scenarios, key or [], objective, seeds, seed, device, robust)
    played_by = shlex.join([names[0], *([] if controller is None else ["--controller", controller]), *(["--set", *set] if set else [])])
    do_tune(task, out or Path("runs") / f"tune-{Path(names[0]).stem}", trials, jobs, gradient, played_by)


def optimise_beam(
    name: str,
    /,
    *,
    metric: Literal["detector", "weber_contrast", "edges"] = "detector",
    energy: Weight = 2.0,
    unevenness: Weight = 0.0,
    glare: Weight = 0.1,
    method: Literal["auto", "gradient", "sampling"] = "auto",
    steps: Count | None = None,
    set: Keys = None,
    out: Path | None = None,
    device: Device = "auto",
    allow_code: AllowCode = False,
) -> None:
    """Optimise the utilisation of every pixel so that objects are detected well with little light, at the start of a scenario.

    Parameters
    ----------
    name
        Scenario file, or name of a shipped scenario. The search starts from its base beam; its lighting functions are ignored.
    metric
        What to maximise: a detector's confidence in the objects, their Weber contrast, or the steepness of their edges.
    energy
        Weight of the lamps' flux, as a share of all pixels on, against the logarithm of the metric.
    unevenness
        Weight of the unevenness of light on objects: standard deviation over mean.
    glare
        Weight of glare: each lx above 1 lx on heads and windscreens.
    method
        gradient descends over all pixels, for luxloop's network and the image metrics; sampling tries a few patches of light, for any
        detector.
    steps
        Steps of the search; by default 80 for gradient, 150 for sampling.
    set
        Keys to change in the scenario, as key=value in TOML syntax, or a TOML file of them.
    out
        Folder for the utilisations, raw.toml to play them with --set, picture and figures; by default runs/beam-NAME.
    device
        Device to compute on; auto takes CUDA if available.
    """
    scenario = scenario_of(name, set, allow_code=allow_code)
    from luxloop.loop.studies.beams import BeamGoal, optimise_beam

    goal = BeamGoal(metric=metric, energy=energy, unevenness=unevenness, glare=glare)
    played_by = shlex.join([name, "--set", *(set or [])])
    optimise_beam(scenario, goal, method, steps, out or Path("runs") / f"beam-{Path(name).stem}", device, played_by)


def train_detector(
    *,
    out: Path = Path("runs/detector"),
    scenes: Count = 600,
    wide: Annotated[int, within(gte=0)] = 400,
    held_out: Count = 100,
    epochs: Count = 68,
    seed: Seed = 0,
    jobs: Count | None = None,
) -> None:
    """Train luxloop's own detector on well-lit scenes and test it on others; writes weights, report and picture.

    Parameters
    ----------
    out
        Folder for scenes, weights and report; existing scenes are reused.
    scenes
        Scenes to train on, 2 MB each.
    wide
        Scenes with bodies of other proportions, loads, poses and textures, and more clutter, to go on with.
    held_out
        Scenes to test it on.
    epochs
        Epochs; each shows every scene in different light and with different objects.
    seed
        Seed of weights, light and noise.
    jobs
        Processes that render scenes; by default one per core.
    """
    from luxloop.loop.studies.training.train import train_detector

    train_detector(out, scenes, wide, held_out, epochs, seed, jobs)


def detect(file: Path, /, *pictures: Path, set: Keys = None, out: Path = Path("runs/detect")) -> None:
    """Show what the network of an ONNX file finds in pictures, and what luxloop takes its outputs for.

    Parameters
    ----------
    file
        ONNX file (see docs/detectors.md).
    pictures
        PNG or JPEG files.
    set
        Keys of the detector, such as detector.layout=yolov8, as key=value in TOML syntax, or a TOML file of them.
    out
        Folder for the pictures with boxes.
    """
    from luxloop.loop.report.detections import draw_detections

    tables.say(draw_detections(file, pictures, set or [], out))
