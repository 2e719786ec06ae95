"""Rows of a recording, one a step: lamps, objects, lighting functions and symbols; and the schema of their columns."""

import math
from collections.abc import Sequence
from typing import Any

import pyarrow as pa
import torch

from luxloop.controllers.functions.carrier_sense import CarrierState
from luxloop.controllers.functions.commands import MOVEMENTS, CommandParams
from luxloop.controllers.functions.planner import Planner, States
from luxloop.loop.recording.checks import baselines
from luxloop.loop.simulation.attribution import WHY
from luxloop.loop.simulation.columns import AIM, CAUSES, CENTROIDS, CUT, ERRORS, LOOKING_OF_TRUTH, POSE, PROJECTION, SYMBOL, loss_name
from luxloop.loop.simulation.evaluator import Evaluation, SymbolStep
from luxloop.loop.simulation.lamps import ShiningModule
from luxloop.loop.simulation.light_figures import quantities
from luxloop.loop.simulation.meeting import Meeting, MeetingPlant
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.metrics import Metrics
from luxloop.world.errors import LuxloopError, did_you_mean, locate
from luxloop.world.regulation import beam_rules

# by the last part of a column's name; all other columns are float64
TYPES = {
    **dict.fromkeys(
        ("step", "primitives", "detections", "false_positives", "tracks", "pixels", "track", "known", "worn", *WHY), pa.int64()
    ),
    **dict.fromkeys(("beam", "loss", "turn"), pa.string()),
    "masked": pa.bool_(),
}
# name: (unit, description)
STEP = {
    "step": ("1", "control step, from 0"),
    "time_s": ("s", "time since the scenario's start"),
    "speed_m_s": ("m/s", "speed of the car, as measured"),
    "curvature_1_m": ("1/m", "curvature of the car's course, as measured"),
    "beam": ("", "base beam"),
    "bend_deg": ("deg", "bend of the base beam to the left"),
    "level_deg": ("deg", "level of the base beam, down"),
    "roll_deg": ("deg", "roll of the base beam, right side down"),
    "primitives": ("1", "number of rectangles of all functions"),
    "dark_lx_max": ("lx", "largest illuminance by the lamps on any object that must be dark; empty while none is in sight"),
    "plan_ms": ("ms", "time from the objects to primitives"),
    "light_ms": ("ms", "time from primitives to utilisations"),
    "look_ms": ("ms", "time of rendering and evaluation, which are not part of the car"),
    "processing_ms": ("ms", "time of everything that the car computes, without look_ms, on one thread of the processor"),
}
BODY = {
    "heave_m": ("m", "heave of the body over the ground"),
    "roll_deg": ("deg", "roll of the body over the ground, right side down"),
    "pitch_deg": ("deg", "pitch of the body over the ground, nose down"),
}
CONTROL = {"control_ms": ("ms", "time of measurement and controllers of all held symbols")}
OBSERVED = {"symbol_iou_min": ("1", "lowest IoU of a symbol with the picture that its observer should see; empty while there is none")}
LAMP = {
    "flux_lm": ("lm", "luminous flux"),
    "power_share": ("1", "power, as a share of all pixels on"),
    "power_factor": ("1", "factor by which the power limit dims all pixels"),
}
LAMP_PEAK = {"flux_lm_peak": ("lm", "highest luminous flux within the step; flux_lm and power are means over the step")}
OBJECT_PEAK = {"lx_peak": ("lx", "highest lx_max within the step; the others are means over the step")}
EYES_PEAK = {"eyes_lx_peak": ("lx", "highest value within the step; eyes_lx_max is a mean over the step")}
LEARNING = {
    "base_share": ("1", "remaining share of the base beam"),
    "flux_lm": ("lm", "luminous flux of all lamps"),
    "power_w": ("W", "electrical power of all lamps, from the model with headlight.standby_w and efficacy_lm_w"),
    "find_ms": ("ms", "time of detector, tracker and learning functions"),
}
LOOKING = {
    "detections": ("1", "number of boxes that the detector found"),
    "false_positives": (
        "1",
        "number of these with a score of at least tracker.start_score that overlap no object by an IoU of 0.3",
    ),
    "tracks": ("1", "number of objects that the tracker has confirmed and not lost"),
    "eyes_lx_max": (
        "lx",
        "largest illuminance by the lamps on heads and windscreens of road users; empty while none is seen",
    ),
    "oncoming_lx_max": (
        "lx",
        "the same for oncoming drivers and riders only, each from 0.3 s after being at least 24 px tall and half visible",
    ),
    "road_lx_ratio_max": (
        "1",
        "largest ratio of the light on a point of the road to the largest setpoint of functions and base beam there",
    ),
}
OBJECT = {
    "pixels": ("px", "number of camera pixels that see it"),
    "lx_min": ("lx", "lowest illuminance by the lamps on its visible part; empty while the camera does not see it"),
    "lx_mean": ("lx", "mean illuminance on its visible part"),
    "lx_max": ("lx", "largest illuminance on its visible part"),
    "masked": ("", "whether a mask must keep it dark"),
}
ZONE = {
    "lx": ("lx", "setpoint of its loop"),
    "luminance": (
        "cd/m^2",
        "mean luminance of its pixels, without the camera's noise; empty while the camera does not see it",
    ),
    "target": ("cd/m^2", "wanted luminance"),
}
MODULE = {
    "swivel_deg": ("deg", "swivel from its rest position, to the left"),
    "level_deg": ("deg", "level from its rest position, down"),
    "intensity": ("1", "maximum intensity as a share of the undimmed one"),
}
PIXELS = {
    "known": ("1", "number of pixels whose gain is known: the road shows them, and the estimate has a standard deviation of at most 0.15"),
    "worn": ("1", "number of these that have lost light for sure"),
}
TURN = ("", "its turn with other cars on its stretch of road: idle (it need not draw), waits or draws")
MATERIAL = {"lx": ("lx", "illuminance"), "luminance": ("cd/m^2", "luminance")}
PROBE = ("lx", "illuminance from the lamps on this probe, a mean over the step; empty while its object does not exist")
EYE = {
    "veil_cd_m2": ("cd/m^2", "veiling luminance by the lamps in an eye at this probe, for the age video.age_years (CIE 146)"),
    "ti_percent": ("%", "threshold increment of that eye, 65 veil / adaptation^0.8"),
}
RULE = ("1", "number of this rule's requirements that the undimmed base beam fails, the larger one of both lamps")
NAN = torch.tensor(torch.nan)
NO_METRICS = Metrics(NAN.expand(2), NAN, NAN, NAN, NAN)
LOOKED_AT = {
    "track": ("", "number of the track that shows it; empty without one"),
    "confidence": (
        "1",
        "confidence of that track, filtered over frames, 0 without one; empty while the camera does not see the object",
    ),
    "score": ("1", "score of the detection in this frame alone, 0 without one; empty in a step without detection"),
}


def schema(simulation: Simulation, detects: bool = False) -> pa.Schema:
    """Columns of a simulation's recording, such as `lamp.left.flux_lm`, `objects.NAME.lx_max`, `modules.left hires.level_deg`.

    detects: whether the columns of a detector are added to those of a simulation without one.
    """
    sides = dict.fromkeys(module.side for module in simulation.modules)
    looks = detects or simulation.pipeline is not None
    held = bool(simulation.controlled)  # so that a step has exposures of different light
    observed = any(getattr(function, "observer", None) for function in simulation.scenario.functions.values())
    columns = STEP | (CONTROL if held else {}) | (OBSERVED if observed else {})
    if simulation.scenario.vehicle is not None:
        sources = {} if simulation.truth is None else {"true": "at the start of the step"}
        for source, when in {**sources, "measured": "by the newest measurement"}.items():
            columns |= {f"body.{source}.{key}": (unit, f"{what}, {when}") for key, (unit, what) in BODY.items()}
    columns |= {f"lamp.{side}.{key}": of for side in sides for key, of in (LAMP | (LAMP_PEAK if held else {})).items()}
    columns |= {f"rules.{rule}": RULE for rule in simulation.scenario.rules}
    columns |= LEARNING if looks or simulation.planner.learns else {}
    if looks:
        looking = LOOKING | (EYES_PEAK if held else {})
        columns |= {key: of for key, of in looking.items() if simulation.truth is not None or key not in LOOKING_OF_TRUTH}
    if simulation.scenario.judge_causes and simulation.pipeline is not None and simulation.truth is not None:
        columns |= {f"causes.{why}": ("1", f"number of {what}") for why, what in WHY.items()}
    of_object = OBJECT | (OBJECT_PEAK if held else {}) | (LOOKED_AT if looks else {})
    columns |= {f"objects.{name}.{key}": of for name in simulation.recorded_ids for key, of in of_object.items()}
    causes = CAUSES if simulation.scenario.judge_causes else {}
    columns |= {f"functions.{name}.{key}": of for name in simulation.controlled for key, of in (SYMBOL | causes).items()}
    if simulation.truth is not None:
        columns |= {f"functions.{name}.{key}": of for name in simulation.scenario.projections for key, of in PROJECTION.items()}
    columns |= {f"modules.{module}.{key}": MODULE[key] for module, key in _moved(simulation.planner, simulation.modules)}
    if simulation.gain_loop is not None:
        columns |= {f"pixels.{module.name}.{key}": of for module in simulation.modules for key, of in PIXELS.items()}
    if simulation.truth is not None:
        columns |= {f"probes.{name}.lx": PROBE for name in simulation.scenario.probes}
        eyes = [name for name, probe in simulation.scenario.probes.items() if probe.adaptation_cd_m2 is not None]
        columns |= {f"probes.{name}.{key}": of for name in eyes for key, of in EYE.items()}
    zones = [name for name, function in simulation.scenario.functions.items() if function.kind == "zone"]
    columns |= {f"functions.{name}.{key}": of for name in zones for key, of in ZONE.items()}
    other = simulation.plant.other.planner.start() if isinstance(simulation.plant, MeetingPlant) else None
    columns |= dict.fromkeys(turns(simulation.planner.start(), other), TURN)
    for name, quantity in quantities(simulation.scenario.functions).items():
        unit, what = MATERIAL[quantity]
        columns |= {
            f"functions.{name}.{quantity}": (unit, f"median {what} of its pixels where a value is wanted; empty out of sight"),
            f"functions.{name}.wanted": (unit, f"{what} wanted"),
        }
    return pa.schema(
        pa.field(name, TYPES.get(name.rpartition(".")[2], pa.float64()), metadata={"unit": unit, "description": text})
        for name, (unit, text) in columns.items()
    )


def _moved(planner: Planner, modules: Sequence[ShiningModule]) -> list[tuple[str, str]]:
    """Commanded modules and their movements. A user's function may command every movement of every module."""

    def of(function: object, module: ShiningModule, movement: str) -> bool:
        return not isinstance(function, CommandParams) or (movement in function.movements and function.moves(module))

    functions = planner.commanding.values()
    return [
        (module.name, movement) for module in modules for movement in MOVEMENTS if any(of(each, module, movement) for each in functions)
    ]


def turns(functions: States, other: States | None) -> dict[str, str]:
    """Turns of functions that sense a carrier, by column. functions: states. other: of the other car, None without one."""
    own: dict[str, str] = {f"functions.{name}.turn": state.turn for name, state in functions.items() if isinstance(state, CarrierState)}
    return own if other is None else own | {f"other_car.{name}": turn for name, turn in turns(other, None).items()}


def row(result: Evaluation) -> dict[str, Any]:
    """Plain values of a step by column of `schema`."""
    base, primitives = result.plan.base, result.plan.primitives
    values: dict[str, Any] = {
        "step": result.step,
        "time_s": result.time_s,
        "speed_m_s": result.now.speed_m_s,
        "curvature_1_m": result.now.curvature_1_m,
        "beam": base.name,
        **{f"{key}_deg": math.degrees(getattr(base, key)) for key in ("bend", "level", "roll")},
        "primitives": 0 if primitives is None else len(primitives),
        "dark_lx_max": result.dark_lx_max,
        "symbol_iou_min": result.symbol_iou_min,
        **{f"{part}_ms": ms for part, ms in result.timings.items()},
        "look_ms": result.timings["plant"] + result.timings["look"],
        "processing_ms": result.processing_ms,
    }
    for source, attitude in result.body.items():
        values |= dict(zip((f"body.{source}.{key}" for key in BODY), attitude, strict=True))
    powers = result.powers.values()
    values |= {"base_share": base.share, "flux_lm": sum(each.flux_lm for each in powers), "power_w": sum(each.watts for each in powers)}
    for side, power in result.powers.items():
        figures = power.flux_lm, power.share, power.factor, power.flux_lm_peak
        values |= {f"lamp.{side}.{key}": value for key, value in zip(LAMP | LAMP_PEAK, figures, strict=True)}
    for name, each in result.objects.items():
        values |= {f"objects.{name}.{key}": getattr(each, key) for key in OBJECT | OBJECT_PEAK}
    for name, held in result.held.items():
        values |= {f"functions.{name}.{key}": value for key, value in symbol_values(held).items()}
    for name, seen in result.projections.items():
        values |= {f"functions.{name}.{key}": getattr(seen, key) for key in PROJECTION}
    for (name, _), command in zip(result.now.lights, result.now.commands, strict=False):  # no commands where all modules are at rest
        values |= {f"modules.{name}.{key}": getattr(command, key) for key in MODULE}
    if (state := result.control.gains) is not None:
        for (name, _), gains in zip(result.now.lights, state.gains, strict=True):
            values |= {f"pixels.{name}.{key}": int(which.sum()) for key, which in zip(PIXELS, (gains.known, gains.worn), strict=True)}
    met = result.reception.plant
    values |= turns(result.planning.functions, met.result.planning.functions if isinstance(met, Meeting) and met.result else None)
    values |= {f"rules.{rule}": len(failures) for rule, failures in result.rules.items()}
    values |= {f"probes.{name}.lx": lx for name, lx in result.probes.items()}
    for name, glare in result.glare.items():
        values |= {f"probes.{name}.{key}": getattr(glare, key) for key in EYE}
    for name, zone in result.zones.items():
        values |= {f"functions.{name}.{key}": getattr(zone, key) for key in ZONE}
    for name, material in result.materials.items():
        values |= {f"functions.{name}.{material.quantity}": material.median, f"functions.{name}.wanted": material.wanted}
    if (look := result.detections) is not None:
        values |= {"tracks": len(look.tracks), "eyes_lx_max": look.eyes_lx_max, "eyes_lx_peak": look.eyes_lx_peak}
        values |= {"oncoming_lx_max": look.oncoming_lx_max, "road_lx_ratio_max": result.road_lx_ratio_max}
        if result.frame is not None:
            values |= {"detections": len(look.found), "false_positives": look.false_positives}
        values |= {f"causes.{why}": count for why, count in look.causes.items()}
        for name in result.objects:
            keys = [key for key in LOOKED_AT if key != "score" or result.frame is not None]
            values |= {f"objects.{name}.{key}": getattr(look.recognised.get(name), key, None) for key in keys}
    return values


def symbol_values(held: SymbolStep) -> dict[str, Any]:
    """Plain values of one symbol in a step, by column of `SYMBOL`."""
    metrics, measurement = held.metrics or NO_METRICS, held.measurement
    tensors = {
        POSE: held.pose,
        ("z_m",): held.z,
        ERRORS: measurement.errors,
        tuple(f"pose_error_{name}" for name in POSE): measurement.pose_error,
        CENTROIDS: measurement.appearance.centroids,
        ("area_ratio",): measurement.area_ratio,
        ("centroid_error_x_percent", "centroid_error_y_percent"): metrics.centroid_percent,
        ("iou", "ssim", "length", "shear"): torch.stack([metrics.iou, metrics.ssim, metrics.length, metrics.shear]),
        ("road_true_m", "road_believed_m"): torch.stack([held.road_true_m, held.road_believed_m]),
        tuple(held.causes): torch.stack([NAN, *held.causes.values()])[1:],
        CUT: held.cut,
        AIM: held.aim,
        ("code",): measurement.code,
    }
    host = torch.cat([tensor.flatten().double() for tensor in tensors.values()]).tolist()
    names = [name for names in tensors for name in names]
    values = {name: value * (180 / math.pi) if name.endswith("_deg") else value for name, value in zip(names, host, strict=True)}
    return values | {"loss": loss_name(int(values.pop("code")))}


def refuse_unknown_columns(simulation: Simulation) -> None:
    """Raises LuxloopError where a check names no numeric column of the recording, a missing baseline, or compares a column that the
    baseline's recording lacks.
    """
    scenario = simulation.scenario
    with locate(scenario.source):
        detected, columns = schema(simulation, detects=True).names, schema(simulation)
        known = [field.name for field in columns if field.type != pa.string()]
        others = {*LEARNING}.union(*(schema(simulation.lit_by(light)).names for light in baselines(scenario.checks)))
        compared = others - {"dark_lx_max", "road_lx_ratio_max"}  # under a baseline's light nothing must be dark
        for name, check in scenario.checks.items():
            where = f"checks.{name}.metric: {check.metric!r}"
            if check.metric not in known:
                if check.metric in detected and check.metric not in columns.names:
                    raise LuxloopError(
                        f'{where} is recorded with a [detector] alone; give one, kind = "truth" say, which knows all objects'
                    )
                known += [f"rules.{rule}" for rule in beam_rules()]
                hint = did_you_mean(check.metric, known, _alternatives(check.metric, known))
                raise LuxloopError(f"{where} is not a numeric column of the recording; {hint}")
            if check.compare is not None and check.metric not in compared:
                raise LuxloopError(
                    f"{where} exists only with lighting functions, so {check.compare} has nothing to compare it with; take a column "
                    "of lamps or objects, or leave compare out"
                )


def _alternatives(metric: str, known: Sequence[str]) -> str:
    """Known columns of the same table or with the same last part; if there are none, all columns, one word a table."""
    table, dot, _ = metric.partition(".")
    alike = [name for name in known if (name.startswith(f"{table}.") if dot else name.endswith(f".{metric}"))]
    tables = dict.fromkeys(f"{name.rpartition('.')[0]}.*" if "." in name else name for name in known)
    return f"known are {', '.join(alike or tables)}"
