"""Apply the changes that `$ROAD_CRG_MODS` asks for: scale, fill NaN, move and turn."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from luxloop.world.opencrg.crg import Crg, CrgError, filled
from luxloop.world.opencrg.surface import CrgSurface

# What OpenCRG libraries do to a file that has no $ROAD_CRG_MODS: fill NaN, start at the origin with heading 0.
LIBRARY_DEFAULTS = {"grid_nan_mode": 2.0, "refpoint_phi": 0.0}
Point = tuple[float, float]
NAN_KEEP, NAN_ZERO, NAN_LAST = range(3)


def modified(crg: Crg, modifiers: Mapping[str, float] | None = None) -> Crg:
    """The grid after `modifiers`, or after the file's own (the libraries' defaults where it has none). Order: scale, NaN, position."""
    own = LIBRARY_DEFAULTS if crg.modifiers is None else crg.modifiers
    mods = own if modifiers is None else modifiers
    crg = replace(_with_nan_handled(_scaled(crg, mods), mods), modifiers={})
    if any(key.startswith("refpoint_") for key in mods):
        return _moved(crg, *_to_reference_point(crg, mods))
    if any(key.startswith("refline_offset_") for key in mods):
        return _moved(
            crg,
            turn=mods.get("refline_offset_phi", 0.0),
            about=(mods.get("refline_rotcenter_x", crg.line("start_x")), mods.get("refline_rotcenter_y", crg.line("start_y"))),
            shift=(mods.get("refline_offset_x", 0.0), mods.get("refline_offset_y", 0.0), mods.get("refline_offset_z", 0.0)),
        )
    return crg


def _scaled(crg: Crg, mods: Mapping[str, float]) -> Crg:
    line = dict(crg.road)
    z = crg.z * mods.get("scale_z_grid", 1.0)
    slope_scale, banking_scale = mods.get("scale_slope", 1.0), mods.get("scale_banking", 1.0)
    _scale(line, slope_scale, "reference_line_start_s", "reference_line_end_s")
    _scale(line, banking_scale, "reference_line_start_b", "reference_line_end_b")
    if "reference_line_end_z" in line:
        start_z = crg.line("start_z")
        line["reference_line_end_z"] = start_z + slope_scale * (line["reference_line_end_z"] - start_z)
    length, width, curvature = (mods.get(f"scale_{name}", 1.0) for name in ("length", "width", "curvature"))
    if length <= 0 or width <= 0:
        raise CrgError(f"{crg.source}: SCALE_LENGTH = {length:g} and SCALE_WIDTH = {width:g} must be positive; correct $ROAD_CRG_MODS")
    if length != 1.0:
        line["reference_line_increment"] *= length
        if "reference_line_end_u" in line:
            line["reference_line_end_u"] = crg.u_start + length * (line["reference_line_end_u"] - crg.u_start)
        line.pop("reference_line_end_z", None)
    _scale(line, width, "long_section_v_right", "long_section_v_left", "long_section_v_increment")
    if length != 1.0 or curvature != 1.0:  # the stored end no longer lies on the line
        line.pop("reference_line_end_x", None)
        line.pop("reference_line_end_y", None)
    phi = crg.phi
    if phi is not None and curvature != 1.0:
        start = crg.line("start_phi")
        phi = start + curvature * (np.unwrap(np.concatenate([[start], phi[1:]])) - start)
        line["reference_line_end_phi"] = float(phi[-1])
    return replace(
        crg,
        z=z,
        v=crg.v * width,
        road=line,
        phi=phi,
        slope=None if crg.slope is None else crg.slope * slope_scale,
        banking=None if crg.banking is None else crg.banking * banking_scale,
    )


def _scale(line: dict[str, float], factor: float, *keys: str) -> None:
    for key in keys:
        if key in line:
            line[key] *= factor


def _with_nan_handled(crg: Crg, mods: Mapping[str, float]) -> Crg:
    if "grid_nan_mode" not in mods and "grid_nan_offset" not in mods:
        return crg
    mode, offset = mods.get("grid_nan_mode", NAN_LAST), mods.get("grid_nan_offset", 0.0)
    if mode not in (NAN_KEEP, NAN_ZERO, NAN_LAST):
        raise CrgError(f"{crg.source}: GRID_NAN_MODE = {mode:g} is unknown; use 0 (keep), 1 (zero) or 2 (last valid value)")
    if mode == NAN_ZERO:
        return replace(crg, z=np.where(np.isfinite(crg.z), crg.z, offset))
    return filled(crg, offset) if mode == NAN_LAST else crg


def _to_reference_point(crg: Crg, mods: Mapping[str, float]) -> tuple[float, Point, tuple[float, float, float]]:
    surface = CrgSurface(crg)

    def coordinate(axis: str, low: float, high: float, default: float) -> float:
        absolute, fraction = mods.get(f"refpoint_{axis}"), mods.get(f"refpoint_{axis}_fraction")
        if absolute is None:
            absolute = default if fraction is None else low + fraction * (high - low)
        return absolute + mods.get(f"refpoint_{axis}_offset", 0.0)

    u = coordinate("u", crg.u_start, crg.u_end, crg.u_start)
    v = coordinate("v", float(crg.v[0]), float(crg.v[-1]), 0.0)
    x, y = (float(value) for value in surface.xy(u, v))
    z = float(surface.z(u, v))
    if math.isnan(z):
        raise CrgError(f"{crg.source}: has no elevation at reference point u = {u:g}, v = {v:g}: add GRID_NAN_MODE = 2 to $ROAD_CRG_MODS")
    target = [mods.get(f"refpoint_{name}", 0.0) for name in ("x", "y", "z", "phi")]
    return target[3] - float(surface.phi(u)), (x, y), (target[0] - x, target[1] - y, target[2] - z)


def _moved(crg: Crg, turn: float, about: Point, shift: tuple[float, float, float]) -> Crg:
    """Turn by `turn` rad about a point, then shift by `[3]` m."""
    line = dict(crg.road)
    cos, sin = math.cos(turn), math.sin(turn)
    for end in ("start", "end"):
        keys = [f"reference_line_{end}_{axis}" for axis in "xy"]
        if end == "start" or all(key in line for key in keys):
            dx, dy = (line.get(key, 0.0) - centre for key, centre in zip(keys, about, strict=True))
            line[keys[0]] = about[0] + cos * dx - sin * dy + shift[0]
            line[keys[1]] = about[1] + sin * dx + cos * dy + shift[1]
        if end == "start" or f"reference_line_{end}_z" in line:
            line[f"reference_line_{end}_z"] = line.get(f"reference_line_{end}_z", 0.0) + shift[2]
        if end == "start" or f"reference_line_{end}_phi" in line:
            line[f"reference_line_{end}_phi"] = line.get(f"reference_line_{end}_phi", 0.0) + turn
    return replace(crg, road=line, phi=None if crg.phi is None else crg.phi + turn)
