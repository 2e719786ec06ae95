"""Write OpenCRG files of all four data kinds."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from luxloop.world.opencrg.crg import KINDS, TEXT_WIDTH, Crg


def write_crg(path: str | Path, crg: Crg, kind: str = "KRBI") -> None:
    """Write a grid as LRFI, LDFI, KRBI or KDBI.

    KDBI keeps every bit, KRBI rounds to float32, the text kinds to the 10 or 20 characters of a column.
    """
    reference = {name: getattr(crg, name) for name in ("phi", "slope", "banking") if getattr(crg, name) is not None}
    table = np.column_stack([*reference.values(), crg.z])
    data = _text(table, TEXT_WIDTH[kind]) if kind in TEXT_WIDTH else _binary(table, KINDS[kind])
    Path(path).write_bytes(_header(crg, kind, list(reference)).encode("latin-1") + data)


def _header(crg: Crg, kind: str, reference: list[str]) -> str:
    lines = ["$CT"]
    v_keys = {"long_section_v_right", "long_section_v_left", "long_section_v_increment"}
    road = {key: value for key, value in crg.road.items() if key not in v_keys}
    road.setdefault("reference_line_end_u", crg.u_end)
    step = crg.road.get("long_section_v_increment", float(np.diff(crg.v).mean()))
    numbered = np.array_equal(crg.v[0] + step * np.arange(len(crg.v)), crg.v)
    road |= {"long_section_v_right": float(crg.v[0]), "long_section_v_left": float(crg.v[-1])}
    if numbered:
        road["long_section_v_increment"] = step
    for name, values in (("ROAD_CRG", road), ("ROAD_CRG_MODS", crg.modifiers), ("ROAD_CRG_OPTS", crg.options)):
        if values:
            lines += ["$", f"${name}", *(f"{key.upper():<26}= {value!r}" for key, value in values.items())]
    lines += ["$", "$KD_DEFINITION", f"#:{kind}"]
    lines += [f"D:reference line {name},{'rad' if name == 'phi' else 'm/m'}" for name in reference]
    for number, v in enumerate(crg.v.tolist(), start=1):
        lines.append(f"D:long section {number},m" if numbered else f"D:long section at v = {v!r},m")
    return "\n".join([*lines, "$" * 72, ""])


def _binary(table: NDArray[np.float64], dtype: np.dtype | None) -> bytes:
    data = table.astype(dtype).tobytes()
    padding = -len(data) % 80 // dtype.itemsize
    return data + np.full(padding, np.nan, dtype).tobytes()


def _text(table: NDArray[np.float64], width: int) -> bytes:
    per_line = 80 // width
    lines = []
    for row in table.tolist():
        cells = [_cell(value, width) for value in row]
        lines += ["".join(cells[at : at + per_line]) for at in range(0, len(cells), per_line)]
    return "\n".join([*lines, ""]).encode("ascii")


def _cell(value: float, width: int) -> str:
    if value != value:
        return "*missing*".rjust(width)
    for digits in range(width - 3, -1, -1):
        text = f"{value:.{digits}f}"
        if len(text) <= width:
            return text.rjust(width)
    return f"{value:.{width - 8}E}".rjust(width)
