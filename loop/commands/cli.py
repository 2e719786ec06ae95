"""The command `luxloop`. Each command imports its heavy modules itself, so that help and lists appear at once."""

import atexit
import gc
import os
import re
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import Any, Literal

from cyclopts import App, CycloptsError, UnknownCommandError, UnusedCliTokensError

from luxloop.loop.commands.exports import export_app
from luxloop.loop.commands.headlight import headlight_app
from luxloop.loop.commands.listing import data_app, doctor, list_, schema
from luxloop.loop.commands.options import (
    DIFFERS,
    FAILED,
    INTERRUPTED,
    OK,
    UNREAD,
    WRONG,
    AllowCode,
    Device,
    Flag,
    Json,
    Keys,
    Seed,
    scenario_of,
)
from luxloop.loop.commands.rig import rig_app
from luxloop.loop.commands.studies import campaign, dataset, detect, evaluate, optimise_beam, train_detector, tune
from luxloop.loop.commands.studio import studio
from luxloop.loop.report import terminal as tables
from luxloop.loop.scenario.shipped import TEMPLATE, copy_text, examples, original
from luxloop.world.errors import LuxloopError, did_you_mean
from luxloop.world.files import installed_version

DEBUG = "--debug"
INSTALL = "--install-completion"


app = App(
    name="luxloop",
    version=installed_version,
    help="Closed-loop control of HD matrix headlights: simulate lamp, road and camera, and control the light with camera feedback.",
    help_epilogue="First run: luxloop run snowflake. With --debug, any command shows the traceback of an error.",
    version_flags=["--version"],
    suppress_keyboard_interrupt=False,
)
app.command(list_, name="list")
for command in (studio, schema, doctor, data_app, headlight_app, export_app, rig_app):
    app.command(command)
for study in (evaluate, campaign, dataset, tune, optimise_beam, train_detector, detect):
    app.command(study)
app.register_install_completion_command(INSTALL, help="Install shell completion for bash, zsh or fish.")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line; returns the exit code. An error that the user can correct is one sentence on stderr and exit code 2."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # SIGTERM ends a command as Ctrl-C does
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as nohup has it
        signal.signal(signal.SIGHUP, signal.default_int_handler)  # so does the end of a terminal: a rig goes dark
    os.environ["PYTHONSAFEPATH"] = "1"  # child processes import nothing from the working folder
    os.environ["MPLBACKEND"] = "agg"  # Jupyter's is not importable everywhere
    gc.set_threshold(10_000)  # imports make 240,000 objects that stay, which the default of 700 goes over again and again
    atexit.register(gc.freeze)  # and the end of the process, too
    warnings.simplefilter("ignore")
    warnings.filterwarnings("default", category=UserWarning)
    warnings.filterwarnings("ignore", message="Sparse CSR tensor support")
    told: set[str] = set()  # once each, which Python forgets when a library changes the filters

    def tell(message: Warning | str, *_: object, **__: object) -> None:
        if str(message) not in told:
            told.add(str(message))
            _say(f"warning: {message}")

    warnings.showwarning = tell
    tokens = sys.argv[1:] if arguments is None else list(arguments)
    try:
        code = app(
            [token for token in tokens if token != DEBUG],
            exit_on_error=False,
            print_error=False,
            result_action="return_value",
            verbose=False,
        )
        sys.stdout.flush()
        return int(code or OK)
    except LuxloopError as error:
        if DEBUG in tokens:
            traceback.print_exception(error)
        print(f"error: {error}", file=sys.stderr)
        return WRONG
    except OSError as error:
        if error.filename is None or INSTALL not in tokens:
            raise
        _say(f"error: {INSTALL}: {error.filename}: cannot be written ({error.strerror}); check HOME and its permissions")
        return WRONG
    except CycloptsError as error:
        _say(f"error: {_complaint(error)}")
        return WRONG
    except KeyboardInterrupt as error:
        for each in (signal.SIGINT, signal.SIGTERM):
            signal.signal(each, signal.SIG_IGN)  # a second one would kill the process while it ends
        _say(f"interrupted{f': {error}' if str(error) else ''}")
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of our output has closed the pipe; without this, Python would complain again when it flushes stdout at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return UNREAD


def _say(text: str) -> None:
    print(" ".join(text.split()), file=sys.stderr)


def _complaint(error: CycloptsError) -> str:
    """An error of the command line as one sentence."""
    command = " ".join(["luxloop", *(error.command_chain or ())])
    if isinstance(error, UnusedCliTokensError):
        return f"{' '.join(error.unused_tokens or ())}: is not expected here; see `{command} --help`"
    if isinstance(error, UnknownCommandError) and error.app and error.unused_tokens:
        name = error.unused_tokens[0]
        return f"there is no command {name!r}; {did_you_mean(name, error.app, f'`{command} --help` shows all')}"
    text = str(error)
    sentences = re.split(r"\.\s+", text.strip().rstrip("."))
    return "; ".join([sentences[0], *(f"{part[:1].lower()}{part[1:]}" for part in sentences[1:])])


@app.command
def new(
    file: Path | None = None,
    /,
    *,
    like: str | None = None,
    traffic: Seed | None = None,
    population: Literal["first", "second"] | None = None,
) -> None:
    """Write a scenario file that is ready to run: a commented template with a symbol, a copy of a shipped scenario or example, or a night.

    Parameters
    ----------
    file
        File to write, such as my.toml; by default named like what is copied. An existing file is never overwritten.
    like
        Shipped scenario or example to copy (see `luxloop list` and `luxloop list examples`), such as gfhb.
    traffic
        Seed: write a random night scene with traffic, road and light instead of the template.
    population
        Bodies of the random night: first (default), as in training of the network; second, others, along a drive on a hilly road.
    """
    if like is not None and traffic is not None:
        raise LuxloopError("--like copies a scenario and --traffic draws one; give one of the two")
    if population is not None and traffic is None:
        raise LuxloopError("--population is that of a night drawn from a seed; give --traffic SEED, too")
    if like is not None:
        source = original(like)
        file = file or Path(source.name)
        if file.suffix != source.suffix:
            raise LuxloopError(f"{file}: --like {like} copies a {source.suffix} file; give its copy the same ending")
        text = copy_text(source, file.stem)
    elif file is not None and traffic is not None:
        from luxloop.loop.scenario.text import night

        text = night(file.stem, traffic, population or "first")
    elif file is not None:
        text = copy_text(TEMPLATE, file.stem)
    else:
        raise LuxloopError("luxloop new: name a file to write, such as my.toml, or give --like NAME to copy under the same name")
    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except FileExistsError as error:
        raise LuxloopError(f"{file}: exists already; name another file, or remove it first") from error
    except OSError as error:
        raise LuxloopError(f"{file}: cannot be written ({error.strerror}); check its folder") from error
    print(
        f"{file} written; "
        + ("its first lines say how to use it" if like in examples() else f"run it with: luxloop run {quote(str(file))}")
    )


@app.command
def check(name: str, /, *, controller: str | None = None, set: Keys = None, json: Json = False, allow_code: AllowCode = False) -> None:
    """Validate a scenario and all that it names (symbols, road, meshes), and whether lamps and camera reach the target.

    Parameters
    ----------
    name
        Scenario file, or name of a shipped scenario.
    controller
        Controller to use instead, with its defaults (see `luxloop list controllers`).
    set
        Keys to change, as key=value in TOML syntax, such as headlight.model=mylamp.npz.
    json
        Print a JSON object: scenario, ok, and either the facts found or the error.
    """
    try:
        scenario = scenario_of(name, set, controller, allow_code=allow_code)
        from luxloop.loop.run import check as check_scenario
        from luxloop.loop.run import in_words

        found = check_scenario(scenario)
    except LuxloopError as error:
        if json:
            tables.show_json({"scenario": name, "ok": False, "error": str(error)})
        raise
    if json:
        tables.show_json({"scenario": name, "ok": True, **found})
    else:
        print("\n".join([f"{name}: ok ({in_words(found)})", *(f"note: {note}" for note in found["notes"])]))


@app.command
def run(
    name: str,
    /,
    *,
    out: Path | None = None,
    set: Keys = None,
    seed: int | None = None,
    steps: int | None = None,
    controller: str | None = None,
    plant: Path | None = None,
    rig: Path | None = None,
    arm: Flag = False,
    twin: Flag = False,
    device: Device = "auto",
    video: bool = True,
    view: Literal["camera", "driver", "chase", "above", "oncoming"] | None = None,
    probe: list[str] | None = None,
    report: bool = True,
    frames: Flag = False,
    labels: Literal["coco", "kitti", "yolo"] | None = None,
    masks: Flag = False,
    depth: Flag = False,
    lux: Flag = False,
    checks: Flag = False,
    allow_code: AllowCode = False,
) -> int:
    """Run a scenario and record it: manifest, trajectory, summary, report and video.

    Parameters
    ----------
    name
        Name of a shipped scenario (see `luxloop list`), or scenario file; with --plant recording the folder of a recording.
    out
        Folder for the recording; by default runs/NAME. An existing recording is replaced.
    set
        Keys to change, as key=value in TOML syntax, such as camera.bits=8 or road.kind=bumps.
    seed
        Seed of all noise.
    steps
        Number of control steps; by default the scenario's, with --plant until the recording ends at most.
    controller
        Controller to use instead, with its defaults (see `luxloop list controllers`).
    plant
        Recording with frames to play back: controllers and functions run on its frames, and their output is not shown. `recording`: that
        of NAME, which is then a recording's folder, with the scenario in it.
    rig
        Rig file of a lamp and a camera on which the scenario runs in place of the simulated world, or whose lamp lights that world if the
        scenario digitises a module (see docs/rig_calibration.md).
    arm
        With --rig: light the lamp. Without it, a dry run shows nothing.
    twin
        With --rig and --arm: simulate the rig's exposures when the run has ended, and compare the frames (see docs/rig.md).
    device
        Device to compute on; auto takes CUDA if available.
    video
        Whether to write video.mp4.
    view
        What video.mp4 shows, as `--set video.view=...`: the camera's frames, or in colour what people see.
    probe
        Luxmeter, as NAME=X,Y,Z in m of the world; more by `--set probes.NAME=...`. Its illuminance becomes a column and a curve.
    report
        Whether to write report.png, which takes seconds.
    frames
        Record the plant's input and output as well: light, frames and sensor samples, megabytes per step.
    labels
        Record frames with boxes, classes and poses of objects, in the layout of COCO, KITTI or YOLO (see docs/data.md).
    masks
        With --labels: masks of instances and parts.
    depth
        With --labels: depth at each pixel.
    lux
        With --labels: illuminance from the lamps at each pixel.
    checks
        Evaluate all checks of the scenario, including those that compare with a second light; exit code 1 if one fails.
    """
    given: dict[str, Any] = {key: value for key, value in {"seed": seed, "steps": steps}.items() if value is not None}
    itself = str(plant) == "recording" and Path(name).is_dir()
    given |= {} if plant is None else {"plant": {"kind": "recording", "folder": name if itself else str(plant)}}
    if rig is not None and plant is not None:
        raise LuxloopError("--rig lights a lamp and --plant plays a recording; give one of the two")
    if arm and rig is None:
        raise LuxloopError("--arm lights the lamp of a rig file; give --rig FILE as well")
    if twin and not arm:
        raise LuxloopError("--twin compares what a lit rig shows with the simulation; give --rig FILE and --arm as well")
    given |= {} if rig is None else {"plant": {"kind": "rig"}}
    set = [*(set or ()), *([] if view is None else [f"video.view={view}"]), *map(_probe, probe or ())]
    scenario = scenario_of(name, set, controller, itself, allow_code, **given)
    if scenario.digitised_module is not None and rig is None and plant is None:
        from luxloop.loop.simulation.simulated import needs_rig

        raise LuxloopError(f"{scenario.source}: {needs_rig(f'modules.{scenario.digitised_module}')}")
    from luxloop.loop.commands.runs import run_scenario

    if plant is not None and steps is None:
        from luxloop.loop.simulation.frames import to_the_end

        scenario = to_the_end(scenario)
    kept = {"video": video, "report": report, "frames": frames, "labels": labels, "masks": masks, "depth": depth, "lux": lux}
    folder = out or Path("runs") / Path(os.path.abspath(name)).stem
    if rig is not None and scenario.digitised_module is not None:
        from luxloop.loop.commands.rig_runs import run_live

        if twin:
            raise LuxloopError("--twin compares a rig's frames with simulated ones, but here all frames are simulated; leave it out")
        passed = run_live(scenario, folder, (rig, arm, allow_code), device, kept)
    elif rig is not None:
        from luxloop.loop.commands.rig_runs import run_on_rig

        passed = run_on_rig(scenario, folder, (rig, arm, allow_code), device, kept, twin)
    else:
        passed = run_scenario(scenario, folder, device, checks, kept)
    return OK if passed or not checks else FAILED


def _probe(given: str) -> str:
    """The override for a probe. Raises LuxloopError unless it is NAME=X,Y,Z."""
    from luxloop.world.params import PLAIN  # imports pydantic

    name, _, place = given.partition("=")
    if not re.fullmatch(PLAIN, name) or not re.fullmatch(r"[-+.\deE]+(,[-+.\deE]+){2}", place):
        raise LuxloopError(
            f"--probe {given}: give a name of lower-case letters, digits and _, and a place in m, as --probe eye=50,1.75,1.1"
        )
    return f"probes.{name}.position_m=[{place}]"


@app.command
def replay(directory: Path, /, *, compare: bool | None = None, csv: Path | None = None, allow_code: AllowCode = False) -> int:
    """Run a recorded scenario again and compare it with the recording; exit code 1 if they differ.

    Parameters
    ----------
    directory
        Folder that `luxloop run` wrote.
    compare
        Whether to run it again and compare; by default yes, unless --csv is given.
    csv
        File to write the recorded steps to, as comma-separated values.
    """
    from luxloop.loop.commands.runs import compare_recording
    from luxloop.loop.recording.replay import to_csv

    if csv is not None:
        to_csv(directory, csv)
        print(f"{csv} written")
    if compare or (compare is None and csv is None):
        return OK if compare_recording(directory, allow_code) else DIFFERS
    return OK


@app.command
def report(directory: Path, /, *, out: Path | None = None, allow_code: AllowCode = False) -> None:
    """Run a recorded scenario again and draw its report.

    Parameters
    ----------
    directory
        Folder that `luxloop run` wrote.
    out
        File for the page, .png, .pdf or .svg; by default report.pdf in the folder.
    """
    from luxloop.loop.commands.runs import draw_report

    print(f"{draw_report(directory, out or directory / 'report.pdf', allow_code)} written")


if __name__ == "__main__":
    sys.exit(main())
