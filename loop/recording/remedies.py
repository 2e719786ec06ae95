"""Causes and remedies of symbols that do not reach their targets, a sentence each."""

from collections.abc import Mapping

import pyarrow as pa

from luxloop.loop.recording.summary import FINAL, OFF_PERCENT, Summary
from luxloop.loop.simulation.columns import CAUSES, PROJECTION, SYMBOL, of_truth

EMPTY = {  # why a column has no value in any step, and the remedy, by the last part of its name or else the first; NAME: all but the last
    "objects": "the camera never saw the object; move NAME.track into its view, or raise steps",
    "probes": "the object in whose frame it lies never existed; see the object's track.appears_s and vanishes_s, or raise steps",
    "functions": "the camera never saw what the function lights; move it into the camera's view, or raise steps",
    "modules": "no function ever commanded the module",
    **dict.fromkeys(("aim_x_m", "aim_y_m"), "the symbol was always aimed at its target"),
    **dict.fromkeys(
        ("road_believed_m", "iou_true_pose", "iou_true_road"), 'its controller has no height map; set NAME.controller.name = "luxloop"'
    ),
    "dark_lx_max": 'no object that must be dark was in view; give a function with kind = "glare_free" and such an object, or raise steps',
    "symbol_iou_min": "no symbol for an observer was shown; see its when, unless, start_s and stop_s",
    **dict.fromkeys(
        ("eyes_lx_max", "eyes_lx_peak", "oncoming_lx_max"),
        "no head or windscreen of such a road user was in view; move one into the camera's view, or raise steps",
    ),
    "road_lx_ratio_max": "no evaluated step had light on the road; set judge_every = 1, and see lighting.base.beam and functions",
    **dict.fromkeys(("detections", "false_positives"), "no frame arrived for the detector; raise steps, or lower camera.drop_probability"),
}
CUT = 0.02  # share of a symbol that is cut without effect: it costs no more IoU than the spread of runs in docs/results/symbol_control.md
PLANE_M = 0.2  # height above the ground plane from which on a remedy names it
SHADOW = "in shadow of"
SHORT = 40  # steps of the shipped scenarios: thesis_pid, started 40 m ahead, still moves after 20 steps and settles within 40
AT_ONCE = ("open", "feedforward", "luxloop")  # controllers that show the symbol at its target, wherever it starts
BORDERS = {  # of the field: name and remedy
    **{side: (side, "bring NAME.y_m nearer to 0") for side in ("left", "right")},
    **{"top": ("upper", "lower NAME.x_m"), "bottom": ("lower", "raise NAME.x_m")},
}


def frame_remedies(frames: dict[str, int]) -> list[str]:
    """Faults of the frames of a run and their remedies, by the summary's `frames`; empty without a fault."""
    numbers = "give each frame the number of its exposure, exposure.number, and test the plant with luxloop.check_plant"
    late = "raise steps if frames are late, lower camera.drop_probability, or test your own plant with luxloop.check_plant"
    if frames["unknown"]:
        return [f"{frames['unknown']} frames belong to no shown exposure and were ignored; {numbers}"]
    return [] if frames["came"] else [f"no frame arrived for any of the {frames['asked']} exposures; {late}"]


def why_empty(metric: str, table: pa.Table) -> str:
    """Why a column of a recording has no value in any step, and the remedy. table: of the recording."""
    (head, _, key), first = metric.rpartition("."), metric.partition(".")[0]
    if first != "functions" or key in EMPTY or key not in {*SYMBOL, *CAUSES, *PROJECTION}:
        return EMPTY.get(key, EMPTY.get(first, "the run recorded no value of it")).replace("NAME", head)
    if (pose := f"{head}.{next(iter(SYMBOL))}") in table.column_names and table[pose].null_count < table.num_rows:
        return f"the symbol was shown, but never {'evaluated; set judge_every = 1' if of_truth(metric) else f'measured; see {head}.loss'}"
    return f"the symbol was never shown in an evaluated step; see {head}.when, unless, start_s, stop_s and indicated, and judge_every"


def why_no_metrics(values: Summary) -> str | None:
    """Why a symbol was not evaluated, by its summary; None where it was."""
    match values["unsettled"]:
        case "not_shown":
            return "never shown"
        case "not_judged" if values["judge_every"] is None:
            return "not evaluated, because the plant does not know the truth"
        case "not_judged":
            return f"not evaluated, because judge_every = {values['judge_every']}"
    return None


def remedies(name: str, values: Summary) -> list[str]:
    """Causes and remedies for a symbol by its summary (`luxloop.loop.recording.summary.summarise`); empty if nothing went wrong."""
    return [each.replace("NAME", f"functions.{name}") for each in _remedies(values)]


def _remedies(values: Summary) -> list[str]:
    cut, why = values["cut"], values["unsettled"]
    is_cut = cut is not None and cut > CUT
    found = [_cut("the symbol", cut, values["cut_side"])] if is_cut else []
    if values["aim"] is not None:
        place = f"lies {values['aim'][0]:.3g} m ahead, the nearest place that they can light"
        found.append(f"on this road the lamps cannot light the target; the symbol {place}")
    if why is not None and not ((is_cut or values["aim"] is not None) and _astray(values)):
        found.append(_cause(values))
    if why is None and values["controller"] != "open" and (values["iou_final"] or 0.0) < (values["iou_open"] or 0.0):
        found.append(f"the symbol has a lower IoU at the last step than without control; {_of_controller(values['controller'])}")
    return found


def target_remedies(name: str, shares: Mapping[str, float]) -> list[str]:
    """Cause and remedy for a target beyond the lamps' field; empty for a negligible share. shares: of the target beyond each border."""
    cut, side = sum(shares.values()), max(shares, key=shares.__getitem__)
    return [_cut("the target of NAME", cut, side).replace("NAME", f"functions.{name}")] if cut > CUT else []


def _cut(what: str, share: float, side: str) -> str:
    border, back = BORDERS[side]
    return f"{100 * share:.0f} % of {what} lies beyond the {border} border of the lamps' field; {back}"


def _astray(values: Summary) -> bool:
    """Whether the symbol is off its target at the end, a moving symbol by its mean error."""
    why, off = values["unsettled"], values["centroid_error_percent"]
    return why in ("lost", "off_target") or (why == "moving" and max(map(abs, off)) > OFF_PERCENT)


def _cause(values: Summary) -> str:
    """Why the symbol has not settled on its target, and the key that helps."""
    off = [abs(error) for error in values["centroid_error_percent"] if error is not None]
    road_m, highest_m = values["road_m"] or 0.0, values["highest_m"]
    if _astray(values) and values["drives"] and highest_m is not None and abs(road_m) > highest_m:
        why = "x m ahead, a road of radius R is about x²/(2R) off that plane"
        within = f"NAME.controller.highest_m = {highest_m:g} of a road that continues the ground's curvature"
        where = f"the road lies up to {_off_plane(road_m, '.2f')} at the target, but heights are searched only within {within}"
        return f"{where}; raise that, to 0.3 at most, or lower NAME.x_m: {why}"
    match values["unsettled"]:
        case "too_short":
            return "too few steps were evaluated to show whether the symbol settles; lower judge_every if it is above 1, or raise steps"
        case "not_shown":
            return "the symbol was never shown; see NAME.when, NAME.unless, NAME.start_s, NAME.stop_s and NAME.indicated"
        case "not_judged" if values["judge_every"] is None:
            return f'{why_no_metrics(values)}; run it with plant.kind = "simulated"'
        case "not_judged":
            return f"{why_no_metrics(values)}; set judge_every = 1"
        case "no_frame":
            keys = "camera.drop_probability or camera.latency_spread_steps"
            return f"most frames of the last {FINAL} steps are missing; lower {keys}, or take disturbances.drops out"
        case "moving":
            what = f"the symbol keeps moving in the last {FINAL} steps"
            if values["shown_steps"] < SHORT and not values["drives"]:
                return f"{what}; raise steps to {SHORT} at least"
            if values["drives"]:
                what += " while the car drives (its IoU in the second half of the run tells how well it lies)"
            elif values["controller"] == "luxloop":
                return f"{what}, as it does if an object moves; otherwise lower NAME.x_m, since a nearer symbol moves less"
        case "covered":
            others = ", ".join(f"functions.{name}" for name in values["covered_by"]) or "other functions"
            return (
                f"{others} took too much light from the symbol to measure it; move one of them, or, if none is a mask, raise NAME.priority"
            )
        case "lost" if not values["seen_steps"]:
            what = "the camera never saw the symbol; on a falling road its light may land out of sight"
            if values["controller"] not in AT_ONCE:
                return f'{what}; lower NAME.start.x_m, and try NAME.controller.name = "luxloop"'
        case "lost":
            what = f"the camera lost the symbol in {values['lost_steps']} of {values['shown_steps']} steps and at the end"
        case _:
            what = f"the symbol lies {max(off):.0f} % of its size off its target" if off else "no light of the symbol reaches its target"
    if values["z_m_final"] and abs(values["z_m_final"]) > PLANE_M:
        what += f", drawn for a road {_off_plane(values['z_m_final'], '.1f')}"
    return f"{what}; {_of_controller(values['controller'])}"


def _off_plane(height_m: float, form: str) -> str:
    return f"{height_m:{form}} m above the plane of the ground" if height_m > 0 else f"{-height_m:{form}} m below the plane of the ground"


def _of_controller(name: str) -> str:
    """Remedy by controller for a symbol that is off its target."""
    match name:
        case "luxloop":
            return "lower NAME.x_m, since a nearer symbol is brighter and less sensitive to the road's height"
        case "feedforward":
            near = "near the plane of the ground, measure it with NAME.controller.survey = true"
            return f"give the true road in NAME.controller.road, or, {near}"
        case _:
            return 'try NAME.controller.name = "luxloop", which estimates the heights of the road and draws for them'
