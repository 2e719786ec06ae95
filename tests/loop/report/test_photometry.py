"""Pictures of photometric files: the curves through the peak, and that every type of photometry can be drawn."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from luxloop.loop.report.photometry import cuts, show_distribution
from luxloop.world.photometry import Distribution, Photometry
from tests.refusal import refusal


def lobe(kind: str) -> Distribution:
    """A lobe that is brightest, 1000 cd, 20 deg above the axis and 10 deg to the right, or 20 deg from nadir in C30."""
    v, h = (np.arange(0.0, 91, 5), np.arange(0.0, 361, 10)) if kind == "C" else (np.arange(-90.0, 91, 5), np.arange(-90.0, 91, 10))
    far = (v - 20) ** 2 + (h[:, None] - (30 if kind == "C" else 10)) ** 2
    return Distribution(kind, v, h, 1000 * np.exp(-far / 8000))  # type: ignore[arg-type]


def test_cuts_go_through_the_peak_of_a_headlamp():
    angles, curves = cuts(lobe("A"))
    across, upright = curves.values()
    assert list(curves) == ["across, 20° up", "upright, 10° right"]
    assert (across.max(), angles[across.argmax()]) == (1000, 10)
    assert (upright.max(), angles[upright.argmax()]) == (1000, 20)
    assert across[angles == 120] == 0, "the file ends at 90 deg"


def test_cuts_of_a_luminaire_are_planes_through_nadir():
    angles, curves = cuts(lobe("C"))
    assert list(curves) == ["C30 – C210", "C120 – C300"]
    plane = curves["C30 – C210"]
    assert (plane.max(), angles[plane.argmax()]) == (1000, 20)
    opposite = float(plane[angles == -20][0])
    assert opposite > 10
    assert opposite == pytest.approx(float(lobe("C").at(20.0, 210.0)))


ANGLES = np.linspace(-10, 10, 21)
NEEDLE = np.exp(-(ANGLES**2) - ANGLES[:, None] ** 2)


@pytest.mark.parametrize(
    "shown",
    [*map(lobe, "ABC"), *(Distribution("A", ANGLES, ANGLES, peak * NEEDLE) for peak in (0.0, 30_000.0))],
    ids=lambda each: each.type,
)
def test_each_type_and_narrow_and_dark_files_are_drawn(shown, tmp_path):
    photometry = Photometry(path=Path("lobe.ies"), format="LM-63-2019", distribution=shown)
    assert cv2.imread(str(show_distribution(photometry, tmp_path / "lobe.png"))).std() > 10
    with refusal("pictures are written as"):
        show_distribution(photometry, tmp_path / "lobe.tiff")
    assert [path.name for path in tmp_path.iterdir()] == ["lobe.png"]
