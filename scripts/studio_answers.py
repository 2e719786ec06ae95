"""Heads of the studio server's messages (docs/programs.md), as a table for scripts/protocol.py, which makes the page's types."""

from collections.abc import Mapping
from typing import Any, Literal, NotRequired

Side = Literal["left", "right"]
Vector = tuple[float, float, float]
Matrix = list[float]  # 16 numbers of a pose, row by row
Window = tuple[int, int, int, int]  # first row, end row, first column, end column

PARTS: Mapping[str, Mapping[str, Any]] = {  # tables within answers; ["Name"] is a list, ("Name", None) an alternative
    # A choice.
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
    # Facts of a run. lamps: their origins by side, in the frame of the car's body.
    "Run": {
        "label": str,
        "overrides": list[str],
        "controllers": dict[str, str],
        "columns": ["Column"],
        "lamps": dict[str, Vector],
        "modules": ["Module"],
        "camera": "Camera",
        "ambient_lx": float,
        "white_cd_m2": float,
        "road": str,
        "street_lamps": ["StreetLamp"],
    },
    # The current scenario with all defaults.
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
    # Pose of a module, and the unit of its light texture.
    "ModulePose": {"T_world_module": Matrix, "scale_cd": float},
    # Pose of a body.
    "BodyPose": {"mesh": int, "T_world_body": Matrix},
    # A lamp of another vehicle.
    "Spotlight": {"position_m": Vector, "axis": Vector, "intensity_cd": float, "width_deg": tuple[float, float]},
    # A held symbol: pose of its primitive, reason of its loss, corners of its target.
    "Symbol": {"pose": tuple[float, float, float, float], "loss": str, "target": list[Vector]},
    # A requirement and the light's value; passed: null if not applicable.
    "BeamPoint": {"id": str, "where": tuple[float, float] | None, "value": float, "unit": str, "limit": str, "passed": bool | None},
    # Light at a point. surface: name of the object, "road", or "wall". normal: in the world. lx: on the surface; vertical_lx: on an upright
    # plane that faces the car; both by the lamps alone. cd_m2: by all light, towards the eye; null on the wall.
    "Reading": {
        "surface": str,
        "point_m": Vector,
        "ground_m": Vector,
        "normal": Vector,
        "h_deg": float,
        "v_deg": float,
        "distance_m": float,
        "cd": float,
        "lx": float,
        "vertical_lx": float,
        "cd_m2": float | None,
    },
    # Pixels of a module, and their total intensity.
    "ModulePixels": {"module": int, "pixels": list[int], "cd": float},
}
ANSWERS: Mapping[str, Mapping[str, Any]] = {  # by type of the message, without `type`
    # New runs. acts: when a key takes effect, by prefix of the key; the longest prefix counts.
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
    # Choices; names of recordings are folders.
    "choices": {
        "scenarios": ["Named"],
        "controllers": ["Named"],
        "rules": list[str],
        "symbols": list[str],
        "lamps": list[str],
        "recordings": ["Named"],
    },
    # New bodies, with arrays of each.
    "meshes": {"run": int, "meshes": ["MeshHead"]},
    # A step. light_windows: window of the texels in `light.K`.
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
    # Values of consecutive steps from `first` on.
    "rows": {"run": int, "first": int},
    # State of the session. recording: folder below runs into which the first run is recorded.
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
    # A refusal in a sentence. about: type of the refused message.
    "error": {"text": str, "about": str | None},
    # Progress of a preparation.
    "progress": {"text": str | None},
    # An edit: a run continues with other values of keys. model, facts: of the newest edit.
    "edit": {"run": int, "step": int, "overrides": list[str], "model": ("Model", None), "facts": ("Run", None)},
    # The scenario as TOML.
    "saved": {"name": str, "text": str},
    # JSON Schema of the scenario's model.
    "schema": {"schema": dict[str, Any]},
    # Results so far, as the recording's summary.
    "summary": {"run": int, "summary": dict[str, Any]},
    # Result of a regulation's requirements.
    "beam": {"run": int, "rule": str, "side": str, "points": ["BeamPoint"]},
    # The light where rays of sight end; null where they meet nothing.
    "meter": {"run": int, "step": int, "readings": [("Reading", None)]},
    # The pixels that light a point.
    "place": {"point_m": Vector, "modules": ["ModulePixels"]},
    # Mean of the wanted illuminances and of the light there; error of the whole field that the pixels light.
    "wish": {"on": Literal["road", "wall"], "wanted_lx": float, "given_lx": float, "rmse_lx": float, "worst_lx": float, "pixels": int},
}
