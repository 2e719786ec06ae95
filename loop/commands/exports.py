"""The commands `luxloop export ...`: a scenario's scene and light at one time, for other programs."""

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from luxloop.loop.commands.options import AllowCode, Keys, scenario_of
from luxloop.loop.report import terminal as tables

At = Annotated[float, Parameter(name="--at")]
export_app = App(name="export", help="Scene and light of a scenario at one time, as files for other programs.")


@export_app.command
def scene(name: str, /, *, out: Path, at_s: At = 0.0, set: Keys = None, allow_code: AllowCode = False) -> None:
    """Write road, objects, camera and lamps as glTF, each as a node with its pose.

    Parameters
    ----------
    name
        Scenario file, or name of a shipped scenario.
    out
        File to write, ending in .glb.
    at_s
        Time in the scenario in s.
    set
        Keys to change, as key=value in TOML syntax, or a TOML file of them.
    """
    scenario = scenario_of(name, set, allow_code=allow_code)
    from luxloop.loop.report.export_scene import write_scene
    from luxloop.loop.run import prepare

    written = write_scene(prepare(scenario, "cpu"), at_s, out)
    nodes, faces = len(written.graph.nodes), sum(len(each.faces) for each in written.geometry.values())
    print(f"{out} written: {scenario.name} at {at_s:g} s, {nodes} nodes, {faces:,} triangles")


@export_app.command
def light(name: str, /, *, out: Path, at_s: At = 0.0, step_deg: float = 0.1, set: Keys = None, allow_code: AllowCode = False) -> None:
    """Write the light texture of each module: all in one .npz, or an IES (LM-63-2019, type A) or EULUMDAT file each.

    Parameters
    ----------
    name
        Scenario file, or name of a shipped scenario.
    out
        File to write, ending in .npz, .ies or .ldt; of several modules, photometric files get their names as well.
    at_s
        Time in the scenario in s; all steps until then are run if the light depends on them.
    step_deg
        Step of the angles of photometric files in deg.
    set
        Keys to change, as key=value in TOML syntax, or a TOML file of them.
    """
    scenario = scenario_of(name, set, allow_code=allow_code)
    from luxloop.loop.report.export_light import write_light
    from luxloop.loop.run import prepare

    files = write_light(prepare(scenario, "cpu"), at_s, out, step_deg)
    print(f"{', '.join(map(str, files))} written: {scenario.name} at {at_s:g} s, {tables.plural(len(files), 'file')}")
