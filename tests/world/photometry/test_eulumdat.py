"""EULUMDAT files: symmetries, oddities, and errors that name their line."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from luxloop.world.photometry import Distribution, read_photometry, write_eulumdat
from luxloop.world.photometry.eulumdat import parse
from tests.refusal import refusal, sentence
from tests.world.photometry.writing import ies, ldt

C, GAMMA = [0, 90, 180, 270], [0, 90, 180]
TABLE = [[10.0, 20, 30], [40, 50, 60]]
PLAIN = ldt(4, C, GAMMA, TABLE)
FIRST_VALUE = 43 + len(C) + len(GAMMA)  # 26 lines, six of a set of lamps, ten ratios, then the angles


def parsed(text: str):  # type: ignore[no-untyped-def]
    return parse(text, Path("lamp.ldt"))


def test_a_plain_file():
    p = parsed(PLAIN)
    assert (p.format, p.luminaire, p.lamps, p.lumens_per_lamp, p.watts) == ("EULUMDAT", "luminaire", 1, 2000, 20)
    assert p.size_m == (-0.2, 0.2, 0.02)  # round
    assert_allclose(p.distribution.candela, 2 * np.array(TABLE))  # cd/klm at 2000 lm
    assert p.warnings == ()


@pytest.mark.parametrize(
    ("symmetry", "stored", "ahead", "left", "behind", "right"),
    [
        (0, 4, 20, 30, 40, 10),
        (1, 1, 10, 10, 10, 10),
        (2, 3, 20, 30, 20, 10),  # C0 to C180; C90 and C270 alike
        (3, 3, 30, 20, 10, 20),  # C270, C0, C90; C0 and C180 alike
        (4, 2, 20, 10, 20, 10),
    ],
)
@pytest.mark.parametrize("planes", [C, [*C, 360]])
def test_symmetries(symmetry, stored, planes, ahead, left, behind, right):
    stored += len(planes) - len(C) if symmetry == 0 else 0  # there C360 is stored, too
    d = parsed(ldt(symmetry, planes, GAMMA, [[1.0, 10 * plane, 1] for plane in range(1, stored + 1)], flux="1000")).distribution
    assert len(d.horizontal_deg) == stored
    around = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]).T
    assert_allclose(d.intensity(around, "nadir"), [ahead, left, behind, right])


def test_symmetry_3_may_store_the_half_behind():
    d = parsed(ldt(3, [90, 180, 270], GAMMA, [[1.0, 10 * plane, 1] for plane in (1, 2, 3)], flux="1000")).distribution
    assert_allclose(d.at(90, [0, 90, 180, 270]), [20, 10, 20, 30])


@pytest.mark.parametrize("number", [24, 29, FIRST_VALUE + 1])
@pytest.mark.parametrize("separator", [" ", "\N{NO-BREAK SPACE}", "\N{THIN SPACE}", "\N{NARROW NO-BREAK SPACE}", "'", "’", ","])
def test_separated_thousands_are_refused_or_told(number, separator):
    text = line_changed(number, f"1{separator}000")
    if separator == ",":
        assert "thousands" in str(parsed(text).warnings)
        with refusal("a decimal point as elsewhere"):
            parsed(line_changed(FIRST_VALUE + 1, "1,000").replace("\n60\n", "\n60.5\n"))
    else:
        with refusal(r"line \d+: expected .* found"):
            parsed(text)


@pytest.mark.parametrize("layout", [lambda t: t.replace("\n", "\r\n"), lambda t: t.replace(".", ","), lambda t: "﻿" + t])
def test_layout_does_not_matter(layout, tmp_path):  # type: ignore[no-untyped-def]
    (tmp_path / "lamp.ldt").write_bytes(layout(ldt(4, C, GAMMA, [[10.5, 20, 30], [40, 50, 60]])).encode())
    assert read_photometry(tmp_path / "lamp.ldt").distribution.candela[0, 0] == 21


def test_a_negative_number_of_lamps_means_absolute():
    p = parsed(ldt(4, C, GAMMA, TABLE, lamps="-1"))
    assert p.absolute and p.lamps == 1
    assert_allclose(p.distribution.candela, 2 * np.array(TABLE))


@pytest.mark.parametrize(
    ("text", "warned"),
    [
        (PLAIN + "END\n", "ignored"),
        (PLAIN + "\x1a", "Ctrl-Z"),
        (PLAIN.replace("\n4000\n80\n20\n", "\n4000\n80\nunknown\n"), "read as 0"),
        (PLAIN.replace("100\n100\n1\n0\n", "100\n100\n2\n0\n"), "conversion factor 2"),
        (PLAIN.replace("100\n100\n1\n0\n", "100\n100\n0\n0\n"), "conversion factor 0"),
        (ldt(4, C, GAMMA, TABLE, flux="1.000"), "read as 1 lm"),
    ],
)
def test_odd_files_are_read_with_a_warning(text, warned):
    warnings = parsed(text).warnings
    assert len(warnings) == 1 and warned in warnings[0]


def line_changed(number: int, value: str) -> str:
    lines = PLAIN.split("\n")
    lines[number - 1] = value
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("number", "value", "expected"),
    [
        (3, "5", "the symmetry Isym (0 to 4), found '5'"),
        (3, "", "expected the symmetry Isym, found '(nothing)'"),
        (4, "many", "expected the number of C planes, found 'many'"),
        (6, "1", "at least 2"),
        (26, "0", "the number of lamp sets (at least 1)"),
        (29, "0", "a luminous flux above 0"),
        (44, "80", "C planes that hold C0 and C90"),
        (45, "20", "expected C plane 3 of 4, ascending"),
        (49, "95o", "expected angle gamma 3 of 3"),
        (FIRST_VALUE + 1, "x", "expected value in cd/klm 2 of 6, found 'x'"),
        (FIRST_VALUE + 1, "-5", "not negative, found '-5'"),
    ],
)
def test_broken_files_name_the_line_and_what_was_expected(number, value, expected):
    with sentence(expected, f"line {46 if number == 44 else number}:"):
        parsed(line_changed(number, value))


@pytest.mark.parametrize("lines", [1, 5, 27, 35, 42, 45, 52])
def test_truncated_files_name_their_end(lines):
    with refusal(r"found the file's end|found '\(nothing\)'"):
        parsed("\n".join(PLAIN.split("\n")[:lines]))


def test_what_a_file_holds_counts_more_than_its_name(tmp_path):
    (tmp_path / "lamp.ldt").write_text(ies([0, 90], [0], [[1, 2]]))
    assert read_photometry(tmp_path / "lamp.ldt").format == "LM-63-2002"
    (tmp_path / "lamp.ies").write_text(PLAIN.replace("\nreport\n", "\nTILT = 15 deg\n"))
    assert read_photometry(tmp_path / "lamp.ies").format == "EULUMDAT"
    (tmp_path / "lamp.txt").write_text(PLAIN)
    assert read_photometry(tmp_path / "lamp.txt").format == "EULUMDAT"


def test_what_is_written_is_read_again(tmp_path):
    c, gamma = np.arange(360.0), np.array([0.0, 1.0, 2.5, 7.0, 180.0])
    candela = 1000 * np.exp(-gamma) * (1 + 0.5 * np.sin(np.radians(c)))[:, None]
    candela[:, -2:] = 0
    written = Distribution("C", gamma, c, candela)
    write_eulumdat(tmp_path / "a.ldt", written, "a lamp, tilted")
    again = read_photometry(tmp_path / "a.ldt")
    assert (again.warnings, again.luminaire, again.distribution.type) == ((), "a lamp, tilted", "C")
    assert np.array_equal(again.distribution.horizontal_deg, c) and np.array_equal(again.distribution.vertical_deg, gamma)
    assert again.distribution.candela == pytest.approx(candela, abs=0.01), "three decimals of cd/klm, 3 lm"
    assert again.lumens_per_lamp == pytest.approx(written.luminous_flux, abs=1e-3)
