"""What went wrong with a symbol that is held, and the key that helps, in a sentence each."""

from collections.abc import Mapping
from typing import Any

from loop.recording.summary import FINAL

CUT = 0.02  # of a symbol; less than that costs no more IoU than two runs may differ by in docs/results/symbol_control.md
PLANE_M = 0.2  # roads nearer to the plane z = 0 are drawn for on it
SHADOW = "in shadow of"
SHORT = 40  # steps, as the shipped scenarios have: thesis_pid still moves after 20 that began 40 m ahead, and settles in 40
AT_ONCE = ("open", "feedforward", "luxloop")  # controllers that show the symbol at its target, wherever it starts
BORDERS = {  # and what brings a symbol back into the field
    **{side: (side, "bring NAME.y_m nearer to 0") for side in ("left", "right")},
    **{"top": ("upper", "lower NAME.x_m"), "bottom": ("lower", "raise NAME.x_m")},
}


def of_frames(frames: dict[str, int]) -> list[str]:
    """What is wrong with the frames of a run, by their part of its summary; empty where nothing is."""
    mend = "give each frame the number of its exposure, exposure.number, and try luxloop.check_plant"
    late = "raise steps where frames are late, lower camera.drop_probability, or try luxloop.check_plant on a plant of your own"
    if frames["unknown"]:
        return [f"{frames['unknown']} frames were of no exposure that was shown, and nothing looked at them; {mend}"]
    return [] if frames["came"] else [f"no frame came of any of the {frames['asked']} exposures, so that nothing was seen; {late}"]


def unjudged(values: dict[str, Any]) -> str | None:
    """Why nobody says how a symbol lies, by its summary; None where somebody does."""
    match values["unsettled"]:
        case "not_shown":
            return "never shown"
        case "not_judged" if values["judge_every"] is None:
            return "nobody judged, as the plant does not know the truth"
        case "not_judged":
            return f"nobody judged, as judge_every = {values['judge_every']}"
    return None


def remedies(name: str, values: dict[str, Any]) -> list[str]:
    """Of the symbol of a name and its summary (`loop.recording.summary.summarise`); empty where nothing went wrong."""
    return [each.replace("NAME", f"functions.{name}") for each in _remedies(values)]


def _remedies(values: dict[str, Any]) -> list[str]:
    cut, why = values["cut"], values["unsettled"]
    is_cut = cut is not None and cut > CUT
    found = [_cut("the symbol", cut, values["cut_side"])] if is_cut else []
    if values["aim"] is not None:
        place = f"lies on it {values['aim'][0]:.3g} m ahead, the nearest place that the lamps light"
        found.append(f"on this road the target cannot be lit as asked; the symbol {place}")
    if why is not None and not ((is_cut or values["aim"] is not None) and why in ("lost", "off_target")):
        found.append(_why_unsettled(values))
    if why is None and values["controller"] != "open" and (values["iou_final"] or 0.0) < (values["iou_open"] or 0.0):
        found.append(f"the symbol lies worse at the last step than without control; {_of_controller(values['controller'])}")
    return found


def of_target(name: str, shares: Mapping[str, float]) -> list[str]:
    """Of the target of a symbol, and what shares of it lie beyond each border of the lamps' field; empty where that is next to nothing."""
    cut, side = sum(shares.values()), max(shares, key=shares.__getitem__)
    return [_cut("the target of NAME", cut, side).replace("NAME", f"functions.{name}")] if cut > CUT else []


def _cut(what: str, share: float, side: str) -> str:
    border, back = BORDERS[side]
    return f"{100 * share:.0f} % of {what} lies beyond the {border} border of the lamps' field; {back}"


def _why_unsettled(values: dict[str, Any]) -> str:
    """Why the symbol has not settled on its target, and the key that helps."""
    off = [abs(error) for error in values["centroid_error_percent"] if error is not None]
    road_m, highest_m = values["road_m"] or 0.0, values["highest_m"]
    astray = values["unsettled"] in ("lost", "off_target")
    if astray and values["drives"] and highest_m is not None and abs(road_m) > highest_m:
        where = f"{abs(road_m):.2f} m {'above' if road_m > 0 else 'below'} the plane of the ground at the target"
        why = "x m ahead, a road of radius R is about x²/(2R) off that plane"
        within = f"NAME.controller.highest_m = {highest_m:g} of a road that bends on as the ground does"
        return f"the road lies up to {where}, and is looked for within {within}; raise that, or lower NAME.x_m: {why}"
    match values["unsettled"]:
        case "too_short":
            return "too few steps were judged to show whether the symbol settles; lower judge_every where it is above 1, or raise steps"
        case "not_shown":
            return "the symbol was never shown; see NAME.when, NAME.unless, NAME.start_s and NAME.stop_s"
        case "not_judged" if values["judge_every"] is None:
            return f'{unjudged(values)}; run it with plant.kind = "simulated"'
        case "not_judged":
            return f"{unjudged(values)}; set judge_every = 1"
        case "no_frame":
            keys = "camera.drop_probability or camera.latency_spread_steps"
            return f"most frames of the last {FINAL} steps are missing; lower {keys}, or take disturbances.drops out"
        case "moving":
            what = f"the symbol goes on moving in the last {FINAL} steps"
            if values["shown_steps"] < SHORT and not values["drives"]:
                return f"{what}; raise steps to {SHORT} at least"
            if values["drives"]:
                what += " while the car drives, where its IoU in the second half says how it lies"
            elif values["controller"] == "luxloop":
                return f"{what}, as it does where an object moves; if none does, lower NAME.x_m, as a nearer symbol moves less"
        case "covered":
            others = ", ".join(f"functions.{name}" for name in values["covered_by"]) or "other functions"
            return (
                f"{others} took too much light from the symbol to measure it; move one of them, or raise NAME.priority where no mask does"
            )
        case "lost" if not values["seen_steps"]:
            what = "the camera never saw the symbol, whose light may pass over a road that falls"
            if values["controller"] not in AT_ONCE:
                return f'{what}; lower NAME.start.x_m, and try NAME.controller.name = "luxloop"'
        case "lost":
            what = f"the camera lost the symbol in {values['lost_steps']} of {values['shown_steps']} steps and at the end"
        case _:
            what = f"the symbol lies {max(off):.0f} % of its size off its target" if off else "no light of the symbol reaches its target"
    if values["z_m_final"] and abs(values["z_m_final"]) > PLANE_M:
        what += f", drawn for a road {abs(values['z_m_final']):.1f} m {'above' if values['z_m_final'] > 0 else 'below'} the plane z = 0"
    return f"{what}; {_of_controller(values['controller'])}"


def _of_controller(name: str) -> str:
    """The remedy for a symbol that does not lie right, by controller."""
    match name:
        case "luxloop":
            return "lower NAME.x_m, as its light is brighter on a nearer road, and the road moves it less"
        case "feedforward":
            return "give the road as it is in NAME.controller.road, or, near the plane z = 0, measure it with NAME.controller.survey = true"
        case _:
            return 'try NAME.controller.name = "luxloop", which draws for the heights of the road that it finds'
