"""Heads of the messages of the studio's server (docs/programs.md), from which scripts/protocol.py makes the types of the page."""

from collections.abc import Mapping
from typing import Any, Final, Literal, NotRequired

Side = Literal["left", "right"]
Vector = tuple[float, float, float]
Matrix = list[float]  # 16 numbers of a pose, row by row
Window = tuple[int, int, int, int]  # first row, end row, first column, end column

PARTS: Final[Mapping[str, Mapping[str, Any]]] = {  # tables within them; lists and alternatives of these are written as such
    # Something to choose from.
    "Named": {"name": str, "description": str},
    # A lamp's module: its grids, and how far it can turn from rest.
    "Module": {
        "name": str,
        "side": Side,
        "rows": int,
        "cols": int,
        "left": float,
        "right": float,
        "bottom": float,
        "top": float,
        "pixel_rows": int,
        "pixel_cols": int,
        "peak_cd": float,
        "flux_lm": float,
        "swivel_deg": tuple[float, float],
        "level_deg": tuple[float, float],
    },
    # The camera's picture, its lens, and what saturates it.
    "Camera": {"width": int, "height": int, "fx": float, "fy": float, "cx": float, "cy": float, "bits": int, "saturation_cd_m2": float},
    # A column of the recording.
    "Column": {"name": str, "unit": str, "description": str},
    # A point source without shadows.
    "StreetLamp": {"position_m": Vector, "intensity_cd": float},
    # What the page must know of a run.
    "Run": {
        "label": str,
        "overrides": list[str],
        "controllers": dict[str, str],
        "columns": ["Column"],
        "modules": ["Module"],
        "camera": "Camera",
        "ambient_lx": float,
        "white_cd_m2": float,
        "road": str,
        "street_lamps": ["StreetLamp"],
    },
    # The scenario as it is now, with all defaults.
    "Model": {"steps": int, "seed": int, "[key: string]": Any},
    # A body. box: of a texture, least x and y, largest x and y in m of the body's frame.
    "MeshHead": {
        "id": int,
        "object": str,
        "kind": Literal["road", "object"],
        "two_sided": bool,
        "box": NotRequired[tuple[float, float, float, float]],
    },
    # Lines in px of the camera's picture, and a text at its place.
    "Mark": {
        "lines": list[tuple[tuple[int, int], tuple[int, int]]],
        "kind": Literal["tracked", "masked", "found", "target", "zone"],
        "text": str,
        "at": tuple[int, int],
    },
    # Where a module is, and the unit of its light texture.
    "ModulePose": {"T_world_module": Matrix, "scale_cd": float},
    # Where a body is.
    "BodyPose": {"mesh": int, "T_world_body": Matrix},
    # A lamp of another vehicle.
    "Spotlight": {"position_m": Vector, "axis": Vector, "intensity_cd": float, "width_deg": tuple[float, float]},
    # A symbol that a controller holds: pose of its primitive, why it was lost, corners of its target.
    "Symbol": {"pose": tuple[float, float, float, float], "loss": str, "target": list[Vector]},
    # A requirement, and what the light does of it; passed: null where it does not apply.
    "BeamPoint": {"id": str, "where": tuple[float, float] | None, "value": float, "unit": str, "limit": str, "passed": bool | None},
    # Pixels of a module, and the intensity that they give together.
    "ModulePixels": {"module": int, "pixels": list[int], "cd": float},
}
ANSWERS: Final[Mapping[str, Mapping[str, Any]]] = {  # by type of the message, without `type`
    # Runs were made anew. acts: when keys act, by the beginning of a key; the longest counts.
    "scenario": {
        "number": int,
        "name": str,
        "source": str,
        "steps": int,
        "rate_hz": float,
        "seed": int,
        "runs": ["Run"],
        "model": "Model",
        "acts": dict[str, Literal["step", "prepared", "restart"]],
    },
    # What there is to choose from; names of recordings are folders.
    "choices": {
        "scenarios": ["Named"],
        "controllers": ["Named"],
        "rules": list[str],
        "symbols": list[str],
        "lamps": list[str],
        "recordings": ["Named"],
    },
    # Bodies that the client lacks, with arrays of each.
    "meshes": {"run": int, "meshes": ["MeshHead"]},
    # A step. light_windows: of the texels in `light.K`.
    "step": {
        "id": int,
        "run": int,
        "step": int,
        "time_s": float,
        "scrub": bool,
        "T_world_ground": Matrix,
        "T_world_body": Matrix,
        "T_world_camera": Matrix,
        "modules": ["ModulePose"],
        "light_windows": dict[str, Window],
        "bodies": ["BodyPose"],
        "spotlights": ["Spotlight"],
        "symbols": {str: "Symbol"},
        "marks": ["Mark"],
        "notes": list[str],
    },
    # Values of steps, from the first on.
    "rows": {"run": int, "first": int},
    # What the session does. recording: folder below runs that the first run is recorded into.
    "status": {
        "playing": bool,
        "speed": float | None,
        "pen": int | None,
        "clients": int,
        "step_ms": float | None,
        "real_time": float | None,
        "failed": str | None,
        "recording": str | None,
    },
    # The answer to `hello`.
    "welcome": {"protocol": int, "version": str, "role": Literal["edit", "watch"], "id": int},
    # What is refused, in a sentence. about: type of the message.
    "error": {"text": str, "about": str | None},
    # What is being prepared.
    "progress": {"text": str | None},
    # A run goes on with other values of keys. model, facts: of the newest edit.
    "edit": {"run": int, "step": int, "overrides": list[str], "model": ("Model", None), "facts": ("Run", None)},
    # The scenario as TOML.
    "saved": {"name": str, "text": str},
    # JSON Schema of the scenario's model.
    "schema": {"schema": dict[str, Any]},
    # Results so far, as the recording's summary.
    "summary": {"run": int, "summary": dict[str, Any]},
    # A regulation's verdict.
    "beam": {"run": int, "rule": str, "side": str, "points": ["BeamPoint"]},
    # The pixels that light a point.
    "place": {"point_m": Vector, "modules": ["ModulePixels"]},
    # How near the light comes to what was wanted.
    "wish": {"on": Literal["road", "wall"], "wanted_lx": float, "rmse_lx": float, "worst_lx": float, "pixels": int},
}
