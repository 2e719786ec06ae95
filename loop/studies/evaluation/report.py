"""The report of an evaluation: tables beside the thesis' own, and figures, as one page of Markdown (T 8.4, 8.5, B.4)."""

from pathlib import Path

from rich.table import Table

from luxloop.loop.report import terminal as tables
from luxloop.loop.report.terminal import number
from luxloop.loop.studies.evaluation import figures
from luxloop.loop.studies.evaluation.evaluate import LAMPS, ROWS, Evaluation, evaluate, summary
from luxloop.loop.studies.jobs.executors import local
from luxloop.world.errors import LuxloopError
from luxloop.world.files import whole

REPORT, FIGURES = "report.md", "figures"

# (mean, median) on the real lamps: T figures 8.5 to 8.8, B.2 to B.7.
THESIS: dict[str, dict[str, tuple[float, float]]] = {
    "hd84": {"jpo": (0.81, 0.82), "mrpc_ratio": (1.081, 1.045), "a_m": (0.91, 0.99), "a_x": (0.70, 0.87), "a_r": (0.65, 0.001)},
    "ssl-hd-lores": {"jpo": (0.19, 0.20), "mrpc_ratio": (1.31, 1.32), "a_m": (1.035, 1.025), "a_x": (0.97, 0.98), "a_r": (0.61, 0.001)},
}
# Changes in % against the reference of MAE, RMSE, DSSIM, MARE in the order of ROWS: T tables 8.2 and 8.3.
THESIS_ROWS = {
    "hd84": ((-9.69, -5.04, -0.52, -21.85), (-10.60, -4.02, 5.03, -34.80), (-10.74, -7.67, -5.54, 19.38), (-11.26, -7.35, -4.13, 10.20)),
    "ssl-hd-lores": (
        (-7.52, -5.04, -1.74, -56.82),
        (-97.65, -95.74, -98.49, -85.74),
        (-97.91, -95.77, -98.48, -90.98),
        (-97.93, -95.79, -98.52, -90.91),
    ),
}
MEASURES = {
    "jpo": "MAE, joint optimum",
    "mrpc": "MAE, MRPC tuned for each setpoint",
    "mrpc_ratio": "ratio MRPC / joint",
    "options_ratio": "ratio, a_ac and sharpening tuned as well",
    "corrected_ratio": "ratio, three corrections on top",
    "ours_ratio": "ratio, one set of our parameters",
    "median_ratio": "ratio, the thesis' median parameters",
    "default_ratio": "ratio, default parameters",
    "a_m": "best a_m",
    "a_x": "best a_x",
    "a_r": "best a_r",
    "options_a_ac": "best a_ac",
    "options_sharpening": "best sharpening",
}
CAPTIONS = {
    "errors": "MAE of the joint optimum, and excess of MRPC's (T figures 8.5 to 8.8)",
    "difference": "Light of MRPC minus that of the joint optimum (T figures 8.9, 8.10)",
    "profiles": "Differences between the two (T figure 8.11)",
    "sensitivity": "Errors of the wide rectangle; bright: small, star: minimum (T figures 8.12 to 8.19)",
    "parameters": "Best parameters (T figures B.2 to B.7)",
}


def run_evaluation(out: Path, lamp: str | None, quick: bool, processes: int | None) -> bool:
    """Evaluate, write the report, print its first table and the failed jobs; returns whether all jobs succeeded.

    Raises what `luxloop.loop.studies.jobs.runner.run` raises.
    """
    found = evaluate(out, LAMPS if lamp is None else (lamp,), quick=quick, executor=local(processes))
    for key, reason in found.failures.items():
        tables.say(f"failed: {key}: {reason}", stderr=True)
    if found.setpoints:
        write_report(found, out)
        tables.show(overview(found))
        print(f"{out / REPORT} written")
    return not found.failures


def write_report(evaluation: Evaluation, out: Path) -> None:
    """Draw the figures and write the page into a folder. Raises LuxloopError where that cannot be written."""
    try:
        figures.draw(evaluation, out / FIGURES)
    except OSError as error:
        raise LuxloopError(f"{out / FIGURES}: cannot be made a folder ({error.strerror}); give another folder with --out") from error
    with whole(out / REPORT) as part:
        part.write_text("# Evaluation\n\n" + page(evaluation, f"{FIGURES}/"), "utf-8")


def overview(evaluation: Evaluation) -> Table:
    """Means of all lamps for the terminal."""
    columns = ("lamp", "setpoints", "MAE joint", "MAE MRPC", "MRPC / joint", "thesis", "with options", "corrected")
    rows = []
    for name in evaluation.lamps:
        values = summary(evaluation.of(name).setpoints)
        joint, mrpc, ratio, *others = (
            f"{values[f'{key}_mean']:.3f}" for key in ("jpo", "mrpc", "mrpc_ratio", "options_ratio", "corrected_ratio")
        )
        thesis = f"{THESIS[name]['mrpc_ratio'][0]:g}"
        rows.append([f"[bold]{name}[/]", f"{values['setpoints']:g}", joint, mrpc, ratio, thesis, *others])
    return tables.plain(columns, rows)


def page(evaluation: Evaluation, images: str) -> str:
    """The results as Markdown. images: prefix of the figures' names in links."""
    return "\n\n".join(part for name in evaluation.lamps for part in _lamp(evaluation.of(name), name, images)) + "\n"


def _lamp(one: Evaluation, name: str, images: str) -> list[str]:
    values = summary(one.setpoints)
    measured = [
        (text, _pair((values[f"{key}_mean"], values[f"{key}_median"])), _pair(THESIS[name].get(key))) for key, text in MEASURES.items()
    ]
    count = f"{values['setpoints']:g} rectangles of 10,000 cd; the joint optima are proved within {100 * values['gap']:.2g} %."
    parts = [f"## {name}", count, tables.markdown_table(["mean (median)", "luxloop", "thesis"], measured)]
    kinds = list(CAPTIONS) if one.sensitivity else [kind for kind in CAPTIONS if kind != "sensitivity"]
    for kind in kinds:
        if kind == "sensitivity":
            parts += _changes(one, name)
        parts.append(f"![{kind}]({images}{kind}-{name}.png)\n\n*{CAPTIONS[kind]}*")
    return parts


def _pair(values: tuple[float | None, float | None] | None) -> str:
    return "–" if values is None else "{} ({})".format(*(number(value, ".3f") for value in values))


def _changes(one: Evaluation, name: str) -> list[str]:
    """Effect of tuning on the wide rectangle, as in T tables 8.2 and 8.3."""
    rows = dict(zip(ROWS, one.tables, strict=False))
    if len(rows) < len(ROWS):
        return []
    errors = ("mae", "rmse", "dssim", "mare")
    reference = rows.pop("reference")
    body = []
    for (key, row), thesis in zip(rows.items(), THESIS_ROWS[name], strict=True):
        changes = [f"{100 * (row[error] / reference[error] - 1):+.1f} ({value:+.1f})" for error, value in zip(errors, thesis, strict=True)]
        body.append([key, *(number(row[f"best_{name}"], ".2f") for name in ("a_m", "a_x", "a_r")), *changes])
    text = (
        "A rectangle of 8.9° x 7.7° (T tables 8.2, 8.3): change in % (the thesis' in brackets) relative to bounding rectangles at half "
        f"of the pixels' peak, without mapping, whose MAE is {reference['mae']:.3f}."
    )
    return [text, tables.markdown_table(["tuned", "a_m", "a_x", "a_r", "MAE", "RMSE", "DSSIM", "MARE"], body)]
