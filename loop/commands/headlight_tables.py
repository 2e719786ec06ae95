"""The tables of the commands `luxloop headlight ...`, and the check of a beam against a regulation's test points."""

import math
from collections.abc import Mapping, Sequence

import torch
from rich.markup import escape
from rich.table import Table

from luxloop.loop.report.facts import borders_deg, flux_lm, peak
from luxloop.loop.report.measure import Values
from luxloop.loop.report.terminal import facts, number, plain
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.lamp import Lamp
from luxloop.world.lamps.modules import ModuleReport
from luxloop.world.lamps.presets import SUMMARIES
from luxloop.world.photometry import Photometry
from luxloop.world.regulation import Result, aim_beam, check_beam, passes, rule_set, sets
from luxloop.world.regulation.tables import Traffic, digits

VERDICTS = {"pass": "green", "fail": "red", "not applicable": "dim", "unknown": "yellow"}
KINDS = {
    "A": "A (headlamps: h round the vertical axis)",
    "B": "B (floodlights: v round the transverse axis)",
    "C": "C (luminaires: v from nadir)",
}

RULE_OF_BEAM: Mapping[str, str] = {
    **dict.fromkeys(("low", "adverse", "motorway"), "r149-passing-c"),
    "town": "r149-passing-v",
    "high": "r149-driving-b",
}


def presets() -> Table:
    """The shipped lamps."""
    rows = ((f"[bold]{name}[/]", escape(summary)) for name, summary in SUMMARIES.items())
    caption = "`luxloop headlight info LAMP` shows what is published about a lamp and what is assumed."
    return plain(("lamp", "description"), rows, caption=caption)


def photometry(file: Photometry) -> Table:
    """Facts of a photometric file."""
    d = file.distribution
    h, v = (int(index) for index in divmod(int(d.candela.argmax()), len(d.vertical_deg)))
    rows = {
        "file": f"{file.path} ({file.format})",
        "luminaire": file.luminaire or "–",
        "photometry": f"type {KINDS[d.type]}, {'absolute' if file.absolute else 'relative to the lamp flux'}",
        "vertical angles": f"{len(d.vertical_deg)}, {d.vertical_deg[0]:g} to {d.vertical_deg[-1]:g} deg",
        "horizontal angles": f"{len(d.horizontal_deg)}, {d.horizontal_deg[0]:g} to {d.horizontal_deg[-1]:g} deg",
        "peak": f"{d.candela.max():,.6g} cd at v = {d.vertical_deg[v]:g}, h = {d.horizontal_deg[h]:g} deg",
        "luminous flux": f"{d.luminous_flux:,.5g} lm" + ("" if file.absolute else f" of {file.lamps} x {file.lumens_per_lamp:,.6g} lm"),
        "power": f"{file.watts:g} W" if file.watts else "–",
        "tilt": file.tilt,
    }
    return facts(rows)


def modules(described: Lamp) -> Table:
    """Modules of a lamp."""
    columns = ("module", "pixels", "texture", "field in deg (left, right; down, up)", "mount", "turns", "entries a texel", "peak", "flux")
    table = plain(columns)
    for module in described.modules:
        light = module.headlight
        full = light.light_texture(torch.ones(light.n_pixels).to(light.matrix.values))
        left, right, bottom, top = borders_deg(light)
        x, y, z = module.T_lamp_module[:3, 3].tolist()
        turns = [
            f"{name} {low:g} to {high:g}"
            for name, (low, high) in (("swivel", module.swivel_deg), ("level", module.level_deg))
            if low or high
        ]
        table.add_row(
            f"[bold]{escape(module.name)}[/]",
            f"{light.pixel_rows} x {light.pixel_cols}",
            f"{light.rows} x {light.cols}",
            f"{left:+.3g}, {right:+.3g}; {bottom:+.3g}, {top:+.3g}",
            f"{x:g}, {y:g}, {z:g} m, {_mount(module.T_lamp_module)}",
            "\n".join(turns) or "–",
            f"{len(light.matrix.values) / light.n_texels:.3g}",
            f"{float(full.max()):,.0f} cd",
            f"{flux_lm(light, full):,.0f} lm",
        )
    return table


def beams(described: Lamp) -> Table:
    """Beams of a lamp: peak, its direction, flux and mean utilisation."""
    rows = []
    for name in [*described.beams, "full"]:
        utilisations = described.beam(name)
        brightest = peak(described, utilisations)
        flux = sum(
            flux_lm(module.headlight, module.headlight.light_texture(u)) for module, u in zip(described.modules, utilisations, strict=True)
        )
        mean = float(torch.cat(tuple(utilisations)).mean())
        place = "even" if brightest.even else f"{brightest.h_deg:+.1f}, {brightest.v_deg:+.1f} deg"
        where = place if brightest.candela else "–"
        rows.append((f"[bold]{escape(name)}[/]", f"{brightest.candela:,.0f} cd", where, f"{flux:,.0f} lm", f"{mean:.1%}"))
    return plain(("beam", "peak", "where (h right, v up)", "flux", "mean utilisation"), rows)


def built(reports: Sequence[ModuleReport]) -> Table:
    """How well each module of a built lamp reproduces its source."""
    columns = (
        "module",
        "pixels",
        "texture",
        "entries a texel",
        "light left out",
        "flux, peak",
        "RMSE to the source",
        "error by fewer overlaps",
    )
    table = plain(columns)
    for each in reports:
        before, after = each.entries_per_texel
        table.add_row(
            f"[bold]{escape(each.name)}[/]",
            f"{each.pixel_rows} x {each.pixel_cols}",
            f"{each.rows} x {each.cols}",
            f"{before:.3g}" if before == after else f"{before:.3g} → {after:.3g}",
            number(each.dropped, ".2%"),
            "–" if each.flux is None else f"{each.flux:.1%}, {each.peak:.1%} of the source's",
            "–" if each.rmse is None else f"{each.rmse:.2%} of the peak, {each.rmse_cd:,.3g} cd",
            "–" if each.overlap is None else f"RMSE {each.overlap.rmse:.2%}, at most {each.overlap.largest:.2%}",
        )
    return table


def rules() -> Table:
    """Sets of test points."""
    rows = []
    for name, each in sorted(sets().items()):
        also = f"\n[dim]also {each.also}[/]" if each.also else ""
        rows.append((f"[bold]{name}[/]{also}", escape(each.title), escape(each.table), escape(each.confidence)))
    return plain(("rule", "description", "table", "confidence"), rows, caption="Second-hand numbers for development, not for approval.")


def results(found: Sequence[Result], title: str) -> Table:
    """Results of a check, one row per requirement."""
    rows = []
    for each in found:
        where = "" if each.where is None else f"{each.where[0]:+.2f}, {each.where[1]:+.2f}"
        room = min(each.value - (-math.inf if each.min is None else each.min), (math.inf if each.max is None else each.max) - each.value)
        decided = each.verdict in ("pass", "fail")
        margin = f"{'+' * (room > 0)}{digits(room)}" if decided else ""
        note = f"\n[dim]{escape(each.note)}[/]" if each.note and not decided else ""
        verdict = f"[{VERDICTS[each.verdict]}]{each.verdict}[/]"
        rows.append((f"[bold]{escape(each.id)}[/]{note}", where, digits(each.value), each.limits, margin, each.unit, verdict))
    failed = sum(each.verdict == "fail" for each in found)
    unknown = sum(each.verdict == "unknown" for each in found)
    caption = f"{failed} of {len(found)} requirements fail" if failed else "passes" if passes(found) else "nothing could be checked"
    caption += f"; {unknown} of {len(found)} requirements are unknown" if unknown else ""
    columns = ("test point", "worst at h, v in deg", "measured", "limit", "margin", "unit", "verdict")
    return plain(columns, rows, "lrrlrl", title=escape(title), caption=caption)


def measured(values: Values, title: str) -> Table:
    """Measured values, a row for each point."""
    rows = ([f"{value:,.5g}" for value in row] for row in zip(*(column.tolist() for column in values.values()), strict=True))
    return plain([escape(name.replace("_", " ")) for name in values], rows, "r", title=escape(title))


def _mount(T: torch.Tensor) -> str:
    """Yaw and pitch of a mount in words, such as "3 deg left, 1 deg down"."""
    forward = T[:3, 0]
    yaw, pitch = math.degrees(math.atan2(forward[1], forward[0])), math.degrees(math.asin(-float(forward[2])))
    words = [f"{abs(yaw):.3g} deg {'left' if yaw > 0 else 'right'}"] if abs(yaw) > 1e-6 else []
    words += [f"{abs(pitch):.3g} deg {'down' if pitch > 0 else 'up'}"] if abs(pitch) > 1e-6 else []
    return ", ".join(words) or "straight ahead"


def check(
    lamp: Lamp, beam: str | None = None, rule: str | None = None, aimed: bool = False, traffic: Traffic = "right"
) -> tuple[str, tuple[Result, ...]]:
    """Title and results of a check of a beam against a rule. aimed: whether the lamp is aimed first, as the regulation requires.

    beam: by default the rule's kind of beam, low or high, or full for a lamp without it and for projections; without a rule the lamp's
    default beam. rule: by default the beam's in RULE_OF_BEAM. Raises LuxloopError for an unknown beam or rule, and a beam without a rule.
    """
    rules = None if rule is None else rule_set(rule)
    if beam is not None:
        lamp.beam(beam)
    if rules is None and (beam or lamp.default_beam) not in RULE_OF_BEAM:
        why = f"{lamp.name} has no low beam, whose rule would be the default" if beam is None else f"no rule is known for beam {beam!r}"
        raise LuxloopError(f"{why}; name a rule with --rule, `luxloop headlight rules` lists them")
    if beam is None:
        wanted = "low" if rules is None else {"low": "low", "projection": "full"}.get(rules.beam, "high")
        beam = wanted if wanted in lamp.beams else "full"
    intensity = lamp.lit(lamp.beam(beam))
    rules = rules or rule_set(RULE_OF_BEAM[beam])
    turn = aim_beam(intensity, rules.id, traffic=traffic) if aimed else (0.0, 0.0)
    turned = f", aimed by {turn[0]:+.2f} deg to the right and {turn[1]:+.2f} deg up" if aimed else ""
    only = sum(module.headlight.n_pixels for module in lamp.modules) <= 1
    what = lamp.name if only else f"{lamp.name}, beam {beam}"
    return f"{what}: {rules.title}{turned}", check_beam(intensity, rules.id, aim=turn, traffic=traffic)


def compliance(lamp: Lamp) -> list[str]:
    """A line for each of the lamp's beams in RULE_OF_BEAM on the number of requirements that the beam meets."""
    lines = []
    for beam in lamp.beams:
        if beam in RULE_OF_BEAM:
            asked = [each for each in check(lamp, beam)[1] if each.verdict in ("pass", "fail")]
            passed = sum(each.verdict == "pass" for each in asked)
            lines.append(f"{beam}: keeps {'all' if passed == len(asked) else passed} of {len(asked)} of {RULE_OF_BEAM[beam]}")
    return lines
