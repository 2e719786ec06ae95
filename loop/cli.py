"""The command `luxloop`. What is heavy to import is imported by the command that needs it, so that help and lists come at once."""

import os
import re
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter, UnusedCliTokensError

from loop import tables
from loop.headlight_cli import headlight_app
from world.errors import LuxloopError

OK, DIFFERS, UNREAD, WRONG, INTERRUPTED = 0, 1, 1, 2, 130


def version() -> str:
    """The installed version of luxloop."""
    from importlib import metadata

    try:
        return metadata.version("luxloop")
    except metadata.PackageNotFoundError:
        return "not installed"


app = App(
    name="luxloop",
    version=version,
    help="Closed loops around HD matrix headlights: what the camera sees of a projected symbol controls the light.",
    help_epilogue="The first run: luxloop run snowflake",
    version_flags=["--version"],
    suppress_keyboard_interrupt=False,
)
data_app = App(name="data", help="Measured roads and light distributions from their public sources.")
app.command(data_app)
app.command(headlight_app)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line; returns the exit code. Whatever the user can mend is one sentence on stderr and exit code 2."""
    warnings.simplefilter("ignore")
    warnings.filterwarnings("default", category=UserWarning)
    warnings.filterwarnings("ignore", message="Sparse CSR tensor support")
    warnings.showwarning = lambda message, *_: _say(f"warning: {message}")
    try:
        tokens = sys.argv[1:] if arguments is None else list(arguments)
        code = app(tokens, exit_on_error=False, print_error=False, result_action="return_value", verbose=False)
        sys.stdout.flush()
        return int(code or OK)
    except LuxloopError as error:
        _say(f"error: {error}")
        return WRONG
    except CycloptsError as error:
        _say(f"error: {_complaint(error)}")
        return WRONG
    except KeyboardInterrupt as error:
        _say(f"interrupted{f': {error}' if str(error) else ''}")
        return INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has gone; Python would complain once more when it flushes stdout at exit. Tables end the same way.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return UNREAD


def _say(text: str) -> None:
    print(" ".join(text.split()), file=sys.stderr)


def _complaint(error: CycloptsError) -> str:
    """What is wrong with a command line, in one sentence."""
    if isinstance(error, UnusedCliTokensError):
        command = " ".join(["luxloop", *(error.command_chain or ())])
        return f"{' '.join(error.unused_tokens or ())}: is not expected here; see `{command} --help`"
    text = str(error)
    sentences = re.split(r"\.\s+", text.strip().rstrip("."))
    return "; ".join([sentences[0], *(f"{part[:1].lower()}{part[1:]}" for part in sentences[1:])])


@app.command(name="list")
def list_() -> None:
    """Show the scenarios that come with luxloop, and what data they lack."""
    tables.show(tables.scenarios())


@app.command
def new(file: Path, /, *, like: str | None = None, traffic: int | None = None) -> None:
    """Write a scenario file, ready to run: a commented one of a symbol with all common keys, or a copy of a shipped one of either kind.

    Parameters
    ----------
    file
        File to write, such as my.toml; one that exists is left alone.
    like
        Shipped scenario to copy (see `luxloop list`), such as gfhb for lighting functions.
    traffic
        Seed of a night with traffic, its road and light, to write in place of it.
    """
    from loop.template import copied, night, template

    if like is not None and traffic is not None:
        raise LuxloopError("--like copies a scenario and --traffic draws one; give one of the two")
    if traffic is not None and traffic < 0:
        raise LuxloopError(f"--traffic {traffic}: a seed is a whole number from 0 on")
    text = night(file.stem, traffic) if traffic is not None else template(file.stem) if like is None else copied(file.stem, like)
    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except FileExistsError as error:
        raise LuxloopError(f"{file}: exists already; name another file, or remove it first") from error
    except OSError as error:
        raise LuxloopError(f"{file}: cannot be written ({error.strerror}); check its folder") from error
    print(f"{file} written; run it with: luxloop run {file}")


@app.command
def check(name: str, /, *, set: Annotated[list[str] | None, Parameter(consume_multiple=True, negative=())] = None) -> None:
    """Validate a scenario and everything that it names: symbol, road, meshes, whether lamps and camera reach the target.

    Parameters
    ----------
    name
        Scenario file, or name of a shipped scenario.
    set
        Keys to change, as key=value in TOML syntax, such as headlight.model=mylamp.npz.
    """
    from loop.run import check as check_scenario
    from loop.scenario import load_any

    print(f"{name}: ok ({check_scenario(load_any(name, set or []))})")


@app.command
def schema(*, kind: Literal["symbol", "lighting"] | None = None) -> None:
    """Print the JSON Schema of scenario files, for editors.

    Parameters
    ----------
    kind
        Scenarios that have a table of this name; by default both kinds.
    """
    import json

    from pydantic import TypeAdapter

    from loop.scenario import AnyScenario, LightingScenario, Scenario

    models: dict[str | None, Any] = {"symbol": Scenario, "lighting": LightingScenario, None: AnyScenario}
    print(json.dumps(TypeAdapter(models[kind]).json_schema(), indent=2))


@app.command
def doctor() -> int:
    """Look at what luxloop needs on this machine, and name the command that mends what is missing."""
    from loop.doctor import all_good, checks

    found = checks()
    tables.show(tables.findings(found))
    return OK if all_good(found) else DIFFERS


@data_app.command(name="list")
def data_list() -> None:
    """Show the files that can be had, and which of them are here."""
    tables.show(tables.data_files())


@data_app.command(name="get")
def data_get(name: str, /, *, dir: Path | None = None) -> None:
    """Fetch a file from its public source, unless it is here.

    Parameters
    ----------
    name
        Name of a file from `luxloop data list`, or "all".
    dir
        Folder to put it into, in place of luxloop's own; point LUXLOOP_DATA to it later.
    """
    from loop import data

    for each in data.registry() if name == "all" else [name]:
        fetched = data.get(each, dir)
        print(f"{each}: {fetched.path}{'' if fetched.downloaded else ' (was here)'}", flush=True)


@app.command
def run(
    name: str,
    /,
    *,
    out: Path | None = None,
    set: Annotated[list[str] | None, Parameter(consume_multiple=True, negative=())] = None,
    seed: int | None = None,
    steps: int | None = None,
    controller: str | None = None,
    device: Literal["auto", "cpu", "cuda"] = "auto",
    video: bool = True,
) -> None:
    """Run a scenario and record it: manifest, trajectory, summary, report and video.

    Parameters
    ----------
    name
        Name of a shipped scenario (see `luxloop list`), or scenario file.
    out
        Folder for the recording; by default runs/NAME. A recording that is there is replaced.
    set
        Keys to change, as key=value in TOML syntax, such as camera.bits=8 or road.kind=bumps.
    seed
        Seed of all noise.
    steps
        Control steps.
    controller
        Controller to take instead, with its defaults.
    device
        Where to compute; auto takes CUDA where there is any.
    video
        Whether to write video.mp4.
    """
    from loop.commands import run_scenario

    values = {"seed": seed, "steps": steps, "controller": None if controller is None else {"name": controller}}
    given = {key: value for key, value in values.items() if value is not None}
    run_scenario(name, out or Path("runs") / Path(name).stem, set or [], given, device, video)


@app.command
def replay(directory: Path, /, *, compare: bool | None = None, csv: Path | None = None) -> int:
    """Run a recorded scenario again and hold it against the recording; exit code 1 where they differ.

    Parameters
    ----------
    directory
        Folder that `luxloop run` wrote.
    compare
        Whether to run it again; by default yes, unless --csv is given.
    csv
        File to write the recorded steps to, as comma-separated values.
    """
    from loop.commands import compare_recording
    from loop.replay import to_csv

    if csv is not None:
        to_csv(directory, csv)
        print(f"{csv} written")
    if compare or (compare is None and csv is None):
        return OK if compare_recording(directory) else DIFFERS
    return OK


@app.command
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
    from loop.evaluate_report import run_evaluation

    return OK if run_evaluation(out, lamp, quick, jobs) else DIFFERS


@app.command
def campaign(
    file: Path,
    /,
    *,
    out: Path | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    device: Literal["auto", "cpu", "cuda"] = "auto",
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
    from loop.campaign_report import do_campaign

    return OK if do_campaign(file, out, jobs, scheduler, device) else DIFFERS


@app.command
def tune(
    names: list[str],
    /,
    *,
    key: Annotated[list[str] | None, Parameter(consume_multiple=True, negative=())] = None,
    objective: str = "settling+residual",
    trials: int = 50,
    seeds: int = 1,
    seed: int = 0,
    set: Annotated[list[str] | None, Parameter(consume_multiple=True, negative=())] = None,
    out: Path | None = None,
    jobs: int | None = None,
    device: Literal["auto", "cpu", "cuda"] = "auto",
    gradient: bool = False,
) -> None:
    """Look for better values of a scenario's keys, such as a controller's gains; what is best becomes a file for --set.

    Parameters
    ----------
    names
        Scenario files, or names of shipped scenarios; a trial runs all of them.
    key
        Keys to tune and their ranges, as key=low:high or key=low:high:log, such as controller.position.kp=0.1:2.
    objective
        What to make small: settling, overshoot, residual, iou and energy, weighted as in settling+0.5*overshoot.
    trials
        Trials that the study shall have in the end.
    seeds
        Runs of each scenario a trial, which differ in their noise.
    seed
        Seed of the search.
    set
        Keys to change in all scenarios, as key=value in TOML syntax, or a TOML file of them.
    out
        Folder for the study, the best values and the report, by default runs/tune-NAME; a study that was stopped goes on from there.
    jobs
        Processes for the runs of a trial, each with one thread; by default one a core. They do not change what is found.
    device
        Where to compute; auto takes CUDA where there is any.
    gradient
        Descend through so many differentiable runs in place of trials; for gains and rate limits of thesis_pid where nothing moves.
    """
    from loop.tune_report import do_tune

    do_tune(names, key or [], objective, trials, seeds, seed, set or [], out, jobs, device, gradient)


@app.command(name="optimise-beam")
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
    set: Annotated[list[str] | None, Parameter(consume_multiple=True, negative=())] = None,
    out: Path | None = None,
    device: Literal["auto", "cpu", "cuda"] = "auto",
) -> None:
    """Look for the utilisation of every pixel by which objects are detected best with little light, at a scenario's first moment.

    Parameters
    ----------
    name
        Scenario file, or name of a shipped scenario, with [lighting]; its base beam is the start.
    metric
        What of the objects shall be high: a detector's confidence, their Weber contrast, or how steep their edges are.
    energy
        Weight of the lamps' flux, as a share of all pixels on, beside the logarithm of the metric.
    unevenness
        Weight of standard deviation over mean of the light on objects.
    glare
        Weight of light on heads and windscreens, for each lx over 1 lx.
    method
        Down the gradient of all pixels, which the network and the metrics have, or sampling of a few patches of light, for any detector.
    steps
        Steps of the search; by default 80 down the gradient, 150 of sampling.
    set
        Keys to change in the scenario, as key=value in TOML syntax, or a TOML file of them.
    out
        Folder for utilisations, raw.toml that plays them by --set, picture and figures, by default runs/beam-NAME.
    device
        Where to compute; auto takes CUDA where there is any.
    """
    from loop.lighting.optimise_beam import optimise_beam

    goal = {"metric": metric, "energy": energy, "unevenness": unevenness, "glare": glare}
    optimise_beam(name, set or [], goal, method, steps, out or Path("runs") / f"beam-{Path(name).stem}", device)


@app.command(name="train-detector")
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
        How often it sees each scene, each time in other light, with other objects put between.
    seed
        Seed of weights, light and noise.
    jobs
        Processes that draw scenes; by default one a core.
    """
    from loop.training.train import train_detector

    train_detector(out, scenes, held_out, epochs, seed, jobs)


if __name__ == "__main__":
    sys.exit(main())
