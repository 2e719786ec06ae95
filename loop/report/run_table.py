"""The closing table of a run."""

from collections import defaultdict
from collections.abc import Mapping

from rich.table import Table

from luxloop.controllers.functions.commands import MOVEMENTS
from luxloop.loop.recording.checks import lines
from luxloop.loop.recording.functions_summary import NAMED, START_UP_S, UNITS, brightest, plain_name
from luxloop.loop.recording.manifest import PIXELS
from luxloop.loop.recording.remedies import frame_remedies, remedies, why_no_metrics
from luxloop.loop.recording.summary import DRAWN, Summary
from luxloop.loop.report.terminal import facts, number, plural
from luxloop.loop.simulation.detection import LEAST_PX

WELL_LIT_LX = 5.0  # illuminance from which on a trained detector finds objects


def summary_table(values: Summary, files: str) -> Table:  # noqa: C901 (a row a quantity)
    """The closing table of a run."""
    rows = {"steps": str(values["steps"])}
    if values["shadow_of"] is not None:
        rows["in shadow"] = f"on the frames of {values['shadow_of']}; the commands of this run were not shown and not evaluated"
        if shadow := values.get("shadow"):
            share, frames = (
                number(shadow["elsewhere"] and 100 * shadow["elsewhere"], ".2g"),
                f"{shadow['exposures']} exposures with a frame",
            )
            rows["light"] = f"other than in the recording in {shadow['differ']} of {frames}, by {share} % of both (mean)"
            if not shadow["differ"]:
                rows["light"] = f"that of the recording, in all {frames}"
    for side, lamp in values["lamps"].items():
        dimmed = f", dimmed to {100 * lamp['power_factor_min']:.0f} % in the worst step" if (lamp["power_factor_min"] or 1.0) < 1 else ""
        rows[f"{side} lamp"] = (
            f"{number(lamp['flux_lm_mean'], '.0f')} lm (mean), {number(lamp['power_share_max'], '.1%')} of its power at most{dimmed}"
        )
    if values.get("low_beam_lm") and all(lamp["flux_lm_mean"] is not None for lamp in values["lamps"].values()):
        flux, low = sum(lamp["flux_lm_mean"] for lamp in values["lamps"].values()), values["low_beam_lm"]
        rows["flux"] = f"{flux:.0f} lm (mean), {flux / low:.0%} of the undimmed low beam's {low:.0f} lm"
    if values.get("modules"):
        rows["modules"] = _modules_row(values["modules"], values["steps"])
    for name, pixels in values.get("pixels", {}).items():
        rows[f"pixels of {name}"] = f"{pixels['worn']:.0f} have worn of {pixels['known']:.0f} that are known, listed in {PIXELS}"
    rows |= _of_light(values["objects"], values["steps"])
    if values["dark_lx_max"] is not None:
        late = ", since masks follow detections in earlier frames" if values["dark_lx_max"] and "detections" in values else ""
        rows["on masked objects"] = f"{values['dark_lx_max']:.3g} lx at most{late}"
    rows |= {f"probe {plain_name(name)}": _probe_row(each) for name, each in values.get("probes", {}).items()}
    for name, symbol in values["functions"].items():
        rows |= {f"{plain_name(name)}: {key}": text for key, text in _symbol_rows(symbol).items()}
    if (flicker := values.get("flicker")) is not None:
        rows["flicker"] = f"a measured symbol is on for {flicker['on_share']:.0%} of a step, at {flicker['rate_hz']:g} Hz"
    for name, zone in values.get("zones", {}).items():
        when = "not settled" if zone["settled_step"] is None else f"within 5 % from step {zone['settled_step']} on"
        rows[f"zone {plain_name(name)}"] = f"{number(zone['luminance'], '.3g')} of {zone['target']:.3g} cd/m^2, {when}"
    for name, each in values.get("materials", {}).items():
        unit = UNITS[each["quantity"]]
        share = f" ({each['median'] / each['wanted']:.0%} of it)" if each["median"] is not None and each["wanted"] else ""
        got = "out of sight" if each["median"] is None else f"{each['median']:.3g} {unit}{share}, median of its pixels at the end"
        rows[f"material {plain_name(name)}"] = f"{each['wanted']:.3g} {unit} wanted: {got}"
    if values["symbol_iou_min"] is not None:
        rows["symbols, as seen by their observers"] = f"IoU {values['symbol_iou_min']:.3f} at least"
    objects = values["objects"].values()
    untracked = "detections" in values and bool(objects) and not any(each["tracks"] for each in objects)
    if values["idle_functions"]:
        nobody = "; no object was tracked yet" if untracked else ""
        why = f"nothing to draw or to command, or nothing within reach of a lamp, in all steps{nobody}"
        rows["without effect"] = f"{', '.join(values['idle_functions'])}: {why}"
    if values.get("energy_j") is not None:
        rows["energy"] = _energy_row(values["energy_j"], values["energy_compared_j"])
        if values["base_share_final"] < 1:
            learnt = values["base_share_final"] < values["base_share_first"]
            why = "; no object was tracked, so none asked for more" if untracked and learnt else ""
            rows["base beam"] = f"{values['base_share_final']:.1%} of its flux left at the end{why}"
    if "detections" in values:
        rows["found"] = f"{number(values['detections'], '.1f')} boxes a step"
        if values.get("false_positives") is not None:
            rows["found"] += f"; {values['false_positives']:.2f} a step with a score high enough to start a track show no object"
        lit = max((light["lx_max"] for light in values["objects"].values() if light["lx_max"] is not None), default=0.0)
        if values["detections"] == 0 and lit >= WELL_LIT_LX:
            rows["found"] = (
                f"no box in any step, though objects in sight had up to {lit:.3g} lx; correct the keys of [detector], or train it again"
            )
        if values.get("eyes_lx_max") is not None:
            most, later = values["eyes_lx_max"], values["eyes_lx_max_after_start_up"]
            rows["on heads and windscreens"] = f"{most:.3g} lx at most, all within the first {START_UP_S:g} s"
            if later is not None:
                after = f"{later:.3g} lx at most from {START_UP_S:g} s on"
                rows["on heads and windscreens"] = f"{after}, {most:.3g} lx including the start-up before"
    if least := {name: each["confidence_min"] for name, each in values["objects"].items() if each.get("confidence_min") is not None}:
        lowest = sorted(least, key=least.__getitem__)
        named = ", ".join(f"{name} {least[name]:.2f}" for name in lowest[:NAMED])
        more = f", {plural(len(lowest) - NAMED, 'other')} {least[lowest[NAMED]]:.2f} or more" if len(lowest) > NAMED else ""
        rows["minimum confidence"] = f"{named}{more}, each from its first track on"
    if values.get("tracks_of_nothing"):
        rows["tracks without object"] = (
            f"in {values['tracks_of_nothing']} of {values['steps']} steps a track shows no object, or one of another track"
        )
    rows |= _of_causes(values.get("causes", {}))
    rows |= _of_lost(values["objects"])
    rows["time a step"] = processing(values, "of one core (median) for all computations of the car")
    rows |= lines(values)
    notes = frame_remedies(values["frames"]) if "frames" in values else []
    several = len(values["functions"]) > 1
    notes += [
        f"{plain_name(name)}: {note}" if several else note for name, each in values["functions"].items() for note in remedies(name, each)
    ]
    if notes and not values["shadow_of"]:
        rows["note"] = "\n".join(notes)
    rows["files"] = files
    return facts(rows)


def _modules_row(modules: Mapping[str, Mapping[str, Summary]], steps: int) -> str:
    """Commands of modules, equal ones in one phrase."""
    alike = defaultdict(list)
    for name, movements in modules.items():
        for movement, figures in movements.items():
            alike[movement, *figures.values()].append(name)
    found = []
    for (movement, least, most, *ends), names in alike.items():
        far = f"{least:.0%} to {most:.0%} of their maximum" if movement == "intensity" else f"{least:.1f}° to {most:.1f}°"
        at_end = f", at the end of the range in {ends[0]} of {steps} steps" if any(ends) else ""
        found.append(f"{'all' if len(names) == len(modules) else ', '.join(names)} {MOVEMENTS[movement]} {far}{at_end}")
    return "; ".join(found)


def _of_light(objects: Mapping[str, Summary], steps: int) -> dict[str, str]:
    """Rows of the light on objects: the brightest one by one, one row for all others in sight, and one for objects never in sight."""
    rows, one_by_one = {}, brightest(objects)
    for name in one_by_one:
        each = objects[name]
        masked = f", masked in {each['masked_steps']} of {steps} steps" if each["masked_steps"] else ""
        rows[f"light on {name}"] = f"{each['lx_mean']:.3g} lx (mean), {each['lx_max']:.3g} lx at most{masked}"
    others = [each["lx_max"] for name, each in objects.items() if name not in one_by_one and each["lx_max"] is not None]
    if others:
        rows[f"light on {plural(len(others), 'other' if one_by_one else 'object')}"] = f"{max(others):.3g} lx at most"
    if unseen := [name for name, each in objects.items() if each["lx_max"] is None]:
        rows["never in sight"] = ", ".join(unseen) if len(unseen) <= NAMED else f"{len(unseen)} objects"
    return rows


def _probe_row(probe: Summary) -> str:
    if probe["lx_mean"] is None:
        return "its object never existed"
    increment = f", threshold increment {probe['ti_percent_max']:.1f} % at most" if "ti_percent_max" in probe else ""
    return f"{probe['lx_mean']:.3g} lx (mean), {probe['lx_min']:.3g} to {probe['lx_max']:.3g} lx{increment}"


def _of_lost(objects: Mapping[str, Summary]) -> dict[str, str]:
    """Rows of the objects that are without a track at times, the largest in the image one by one."""
    gone = {name: each for name, each in objects.items() if each.get("steps_in_sight") and (each["steps_lost"] or not each["tracks"])}
    hopeless = [name for name, each in gone.items() if not each["tracks"] and not each.get("findable", True)]
    gone = {name: each for name, each in gone.items() if name not in hopeless}
    rows, largest = {}, sorted(gone, key=lambda name: -gone[name]["pixels_max"])
    for name in largest[:NAMED]:
        each = gone[name]
        word, steps = ("lost", each["steps_lost"]) if each["tracks"] else ("missed", each["steps_in_sight"])
        large = "" if each["tracks"] else f", of {each['pixels_max']:.0f} px at most"
        rows[f"{word} {name}"] = f"no track shows it in {steps} of the {each['steps_in_sight']} steps in which it is in sight{large}"
    if smaller := largest[NAMED:]:
        missed = sum(not gone[name]["tracks"] for name in smaller)
        rows["smaller objects"] = f"{missed} missed, {len(smaller) - missed} lost, of {gone[smaller[0]]['pixels_max']:.0f} px at most"
    if hopeless:
        who = ", ".join(map(plain_name, hopeless)) if len(hopeless) <= NAMED else f"{len(hopeless)} objects"
        rows["not to be found"] = f"{who}: of no class that the detector has, or never {LEAST_PX:g} px tall"
    return rows


def processing(values: Summary, what: str) -> str:
    """Processing time of a step in ms and as a multiple of the control period. what: description of the time."""
    times = values["times_real_time"]
    return f"{number(values['processing_ms_median'], '.0f')} ms {what}" + ("" if times is None else f", {times:.2g} of the control period")


def _symbol_rows(values: Summary) -> dict[str, str]:
    if (why := why_no_metrics(values)) is not None:
        return {"result": why, "lost steps": f"{values['lost_steps']}{_lost_details(values)}"}
    x, y = values["centroid_error_percent"]
    settled = values["settle_step"]
    late, least = (number(values[f"iou_second_half_{each}"], ".3f") for each in ("mean", "min"))
    mean, ended, without = (number(values[key], ".3f") for key in ("iou_mean", "iou_final", "iou_open"))
    causes = {"mean IoU drawn otherwise": told} if (told := _causes(values)) else {}
    return {
        "settle step": f"{settled} of {values['shown_steps']}" if settled is not None else "not settled",
        "centroid error": f"{number(x, '.2f')} % along, {number(y, '.2f')} % across",
        "IoU": f"{mean} on average; {late} and {least} at least in the second half; at the last step {ended}, {without} without control",
        **causes,
        "overshoot": number(values["overshoot_percent"], ".1f", " %"),
        "lost steps": f"{values['lost_steps']}{_lost_details(values)}",
    }


def _of_causes(causes: Mapping[str, Mapping[str, int]]) -> Mapping[str, str]:
    """Rows of what was dazzled, untracked or false, with the share of each cause; empty without `judge_causes`."""
    rows = {}
    for what, unit in (("dazzled", "heads"), ("untracked", "objects"), ("false", "tracks")):
        counts = {why.removeprefix(f"{what}_"): each["count"] for why, each in causes.items() if why.startswith(what)}
        if total := sum(counts.values()):
            shares = ", ".join(f"{why} {count / total:.0%}" for why, count in counts.items() if count)
            rows[f"{what} {unit}"] = f"{total} over all steps: {shares}"
    return rows


def _causes(values: Summary) -> str:
    """Mean IoU of a symbol drawn otherwise; empty without `judge_causes`."""
    found = {what: values[f"{key}_mean"] for key, what in DRAWN.items()}
    return ", ".join(f"{iou:.3f} {what}" for what, iou in found.items() if iou is not None)


def _lost_details(values: Summary) -> str:
    names = ", ".join(map(plain_name, values["covered_by"])) or "other functions"
    blind = values["shown_steps"] - values["seen_steps"] - values["lost_steps"]
    covered = f", of which {names} covered it in {values['covered_steps']}" if values["covered_steps"] else ""
    return covered + (f", and {blind} without a frame" if blind else "")


def _energy_row(own_j: float, compared_j: Mapping[str, float]) -> str:
    standby, *others = compared_j.items()
    beams = "".join(f", {name} {_joules(joules)}" for name, joules in others)
    undimmed = f"; undimmed{beams[1:]}" if beams else ""
    return f"{_joules(own_j)} by the lamp model, {_joules(standby[1])} of it {standby[0]}{undimmed}"


def _joules(joules: float) -> str:
    return f"{joules:.3g} J" if joules < 100 else f"{joules:.0f} J"
