"""Recorded columns of a closed-loop symbol, and their extraction from a recording."""

from collections.abc import Sequence

import pyarrow as pa

from luxloop.controllers.symbol.sensing.field import SIDES
from luxloop.perception.appearance import DEGREES, DegreeOfFreedom
from luxloop.perception.extraction import ExtractionStatus

CUT = tuple(f"cut_{side}" for side in SIDES)
AIM = ("aim_x_m", "aim_y_m")
POSE = tuple(degree.key for degree in DEGREES)
ERRORS = tuple(f"e_{degree.name}" for degree in DEGREES)
CENTROIDS = tuple(f"{point}_{axis}" for point in ("c", "tl", "tr", "bl", "br") for axis in "uv")


def symbol_columns(degrees: Sequence[DegreeOfFreedom]) -> dict[str, tuple[str, str]]:
    """Unit and description of the columns of a closed-loop symbol. The camera sees the light camera.latency_steps later."""
    return {
        **{each.key: (each.suffix, each.shown) for each in degrees if each.unit == "m"},
        "z_m": ("m", "shown height of the primitive's centre above the assumed road"),
        **{each.key: (each.suffix, each.shown) for each in degrees if each.unit == "rad"},
        "cut_left": ("1", "share of the shown symbol that is cut: it lies beyond the left border of the lamps' field"),
        "cut_right": ("1", "share cut at the right border"),
        "cut_top": ("1", "share cut at the upper border"),
        "cut_bottom": ("1", "share cut at the lower border"),
        "aim_x_m": ("m", "place on the road where the symbol is aimed, if its target cannot be lit; null for the target"),
        "aim_y_m": ("m", "the same to the left"),
        **{f"e_{each.name}": each.error for each in degrees},
        **{f"pose_error_{each.key}": (each.suffix, f"e_{each.moves} divided by its plant gain") for each in degrees},
        "c_u": ("axes", "centroid of the extracted symbol, u to the right"),
        "c_v": ("axes", "centroid of the extracted symbol, v down or towards the car"),
        **{
            f"{point}_{axis}": ("axes", f"centroid of the {name} quadrant, {axis}")
            for point, name in (("tl", "top left"), ("tr", "top right"), ("bl", "bottom left"), ("br", "bottom right"))
            for axis in "uv"
        },
        "area_ratio": ("1", "area of the extracted symbol relative to its area on the flat road or on the acquired road"),
        "loss": (
            "",
            "why the symbol was lost: no_frame, nothing, too_small, too_large or covered (by other functions); empty if it was seen",
        ),
        "centroid_error_x_percent": ("%", "evaluator: error of the centroid along x, in % of the symbol's length"),
        "centroid_error_y_percent": ("%", "evaluator: error of the centroid along y, in % of the symbol's width"),
        "iou": ("1", "evaluator: intersection over union with the target"),
        "ssim": ("1", "evaluator: structural similarity to the target"),
        "length": ("1", "evaluator: second-moment length relative to the target's"),
        "shear": ("1", "evaluator: shear mu11 / mu20 on the road plane"),
        "road_true_m": ("m", "evaluator: mean height of the road in the target's area, above the plane of the ground"),
        "road_believed_m": ("m", "evaluator: the same as the controller's height map has it; empty without a map"),
    }


SYMBOL = symbol_columns(DEGREES)

MOTION = ("centroid_motion_x_percent", "centroid_motion_y_percent")

# with judge_causes
CAUSES = {
    "iou_open": ("1", "evaluator: IoU of the symbol in open loop"),
    "iou_true_pose": ("1", "evaluator: IoU of the symbol drawn for the body's true pose; empty if the controller has no height map"),
    "iou_true_road": ("1", "evaluator: IoU of the symbol drawn for the true road; empty if the controller has no height map"),
    "iou_true": ("1", "evaluator: IoU of the symbol drawn for the true road from the true pose, the best that the lamp can show"),
    "iou_end": ("1", "evaluator: IoU of the shown symbol at the end of its light; empty if the vehicle stands"),
    **dict.fromkeys(MOTION, ("%", "evaluator: centroid error less that of the symbol drawn for the body's true pose")),
}

PROJECTION = {
    "aside_m": ("m", "evaluator: largest distance of the seen symbol from the vehicle's course"),
    "near_m": ("m", "evaluator: least distance of the seen symbol ahead of the lamps"),
    "far_m": ("m", "evaluator: largest distance of the seen symbol ahead of the lamps"),
    "cd_max": ("cd", "evaluator: largest intensity of one lamp towards the symbol"),
    "h_deg_max": ("deg", "evaluator: largest angle of the symbol to a side, from a lamp"),
    "v_deg_max": ("deg", "evaluator: highest angle of the symbol, from a lamp; negative below its height"),
    "contrast": ("1", "evaluator: Weber contrast of the symbol to the road within 30' of it, as the driver sees them"),
    "modulation": ("1", "evaluator: Michelson contrast of the symbol's light between its strokes and gaps, as the driver sees them"),
    "stroke_arcmin": ("arcmin", "evaluator: mean width of the symbol's strokes, as the driver sees them"),
}

# columns of lighting functions that need the truth
LOOKING_OF_TRUTH = ("false_positives", "eyes_lx_max", "eyes_lx_peak", "oncoming_lx_max", "road_lx_ratio_max")
OF_TRUTH = {
    "dark_lx_max",
    "symbol_iou_min",
    "luminance",
    *LOOKING_OF_TRUTH,
    *CAUSES,
    *PROJECTION,
    *(key for key in SYMBOL if SYMBOL[key][1].startswith("evaluator: ")),
}


def of_truth(column: str) -> bool:
    """Whether a column is missing or empty without the truth."""
    return column.startswith(("objects.", "probes.", "body.true.")) or column.rpartition(".")[2] in OF_TRUTH


def held_in(table: pa.Table) -> list[str]:
    """Names of the closed-loop symbols in a recording."""
    return [each.removeprefix("functions.").removesuffix(".iou") for each in table.column_names if each.endswith(".iou")]


def of_one(table: pa.Table, name: str) -> pa.Table:
    """Step, time, the SYMBOL columns of one symbol and its CAUSES if known, for the steps in which it is shown."""
    known = [key for key in CAUSES if f"functions.{name}.{key}" in table.column_names]
    names = {"step": "step", "time_s": "time_s", **{key: f"functions.{name}.{key}" for key in [*SYMBOL, *known]}}
    found = pa.table({key: table[column] for key, column in names.items()})
    return found.filter(found["x_m"].is_valid())


def loss_name(code: int) -> str:
    """A status code in a recording: "" for a measured symbol, else the reason of the loss in lower case."""
    return "" if code == ExtractionStatus.SEEN else ExtractionStatus(code).name.lower()
