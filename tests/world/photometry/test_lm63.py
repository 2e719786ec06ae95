"""LM-63 files: editions, oddities, errors that name their line, and the way back through the writer."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from luxloop.world.photometry import Distribution, read_photometry, write
from luxloop.world.photometry.lm63 import parse
from tests.refusal import refusal, sentence
from tests.world.photometry.writing import ies

V, H, TABLE = [0.0, 45, 90], [0.0, 90], [[10.0, 20, 30], [40, 50, 60]]
PLAIN = ies(V, H, TABLE)
HEAD, BODY = PLAIN[: PLAIN.index("NONE\n") + 5], PLAIN.partition("NONE\n")[2]


def parsed(text: str):  # type: ignore[no-untyped-def]
    return parse(text, Path("lamp.ies"))


def test_a_plain_file():
    p = parsed(PLAIN)
    assert p.format == "LM-63-2002" and p.absolute and p.lamps == 1 and p.watts == 10 and p.warnings == ()
    assert p.keywords == {"TEST": "1"} and p.luminaire == "lamp"
    np.testing.assert_array_equal(p.distribution.candela, TABLE)
    np.testing.assert_array_equal(p.distribution.vertical_deg, V)
    np.testing.assert_array_equal(p.distribution.horizontal_deg, H)


@pytest.mark.parametrize(
    ("head", "edition", "warned"),
    [
        ("", 1986, "version"),
        ("any words\nat all\n", 1986, "version"),
        ("IESNA86\n", 1986, None),
        ("IESNA91\n[TEST] x\n", 1991, None),
        ("IESNA:LM-63-1995\n", 1995, None),
        ("IESNA:LM-63-2002\n", 2002, None),
        ("IES:LM-63-2019\n", 2019, None),
        ("IES:LM-63-2044\n", 2019, "edition 2044, which is unknown: read as 2019"),
        ("IESNA:LM-63-2002\nSCCS stray\n", 2002, "line 2"),
    ],
)
def test_editions(head, edition, warned):
    p = parsed(ies(V, H, TABLE, head=head))
    assert p.format == f"LM-63-{edition}"
    assert (warned is None and not p.warnings) or (warned and warned in p.warnings[0])


def test_factors_are_applied_but_for_the_one_whose_meaning_changed():
    text = ies(V, H, TABLE, lumens=500, multiplier=2, ballast=0.5).replace("0.5 1 10", "0.5 1.101 10")
    p = parsed(text)
    np.testing.assert_array_equal(p.distribution.candela, TABLE)
    assert (p.lumens_per_lamp, p.multiplier, p.ballast_factor, p.field_12, p.absolute) == (500, 2, 0.5, 1.101, False)


@pytest.mark.parametrize("head", ["any words\n", "IESNA91\n"])
def test_the_ballast_lamp_factor_of_old_editions_is_applied(head):
    p = parsed(ies(V, H, TABLE, head=head, ballast=0.9).replace("0.9 1 10", "0.9 0.8 10"))
    np.testing.assert_allclose(p.distribution.candela, 0.72 * np.array(TABLE))
    assert "ballast-lamp factor 0.8" in p.warnings[-1]


NUMBERS = [match.span() for match in re.finditer(r"\S+", PLAIN) if match.start() > PLAIN.index("NONE")][1:]


@pytest.mark.parametrize("separator", [",", " ", "\N{NO-BREAK SPACE}", "\N{THIN SPACE}", "\N{NARROW NO-BREAK SPACE}", "'", "’"])
def test_separators_within_any_number_are_refused(separator):
    for start, end in NUMBERS:
        for number in (f"1{separator}000", f"12{separator}500", f"{PLAIN[start:end]}{separator}5"):
            with refusal(r"line \d+: expected"):
                parsed(PLAIN[:start] + number + PLAIN[end:])


@pytest.mark.parametrize(
    "layout",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: HEAD + BODY.replace(" ", "\n"),
        lambda text: HEAD + BODY.replace(" ", ", "),
        lambda text: HEAD + BODY.replace("\n", "\t \n\n"),
        lambda text: text.replace("TILT=NONE", "  tilt = none "),
        lambda text: "﻿" + text,
    ],
)
def test_layout_does_not_matter(layout, tmp_path):  # type: ignore[no-untyped-def]
    file = tmp_path / "lamp.ies"
    file.write_bytes(layout(PLAIN).encode())
    p = read_photometry(file)
    assert p.warnings == () and p.format == "LM-63-2002"
    np.testing.assert_array_equal(p.distribution.candela, TABLE)


@pytest.mark.parametrize(
    ("text", "warned"),
    [
        (PLAIN + "END\n\x1a", "'END'"),
        (PLAIN.rstrip() + "\x1a", "Ctrl-Z"),
        (PLAIN + "\x1a7 8 9", "Ctrl-Z, what follows is ignored"),
        (PLAIN.replace("1 1 10", "1 2 10"), "which LM-63-2002 does not define: not applied"),
        (PLAIN.replace("2 0 0 0", "2 -0.1 0 0"), "round"),
        (PLAIN.replace("2 0 0 0", "7 0 0 0"), "read as metres"),
        (PLAIN.replace("30\n", "-0.01\n"), "read as zero"),
        (PLAIN.replace("\n0 90\n", "\n0 10\n"), "dark"),
        (ies(V, H, TABLE, code=3), "mirrored"),
        (ies(V, H, TABLE, lumens=0), "0 lumens per lamp: read as absolute"),
    ],
)
def test_odd_files_are_read_with_a_warning(text, warned):
    p = parsed(text)
    assert any(warned in warning for warning in p.warnings), p.warnings
    assert p.distribution.candela.shape == (2, 3)


@pytest.mark.parametrize(
    ("text", "line", "expected"),
    [
        ("IESNA91\nnothing\n", 2, "expected a TILT= line"),
        (PLAIN.replace("40 50 60\n", ""), 8, "expected candela value 4 of 6, found the file's end"),
        (PLAIN.replace("50", "5O"), 9, "expected candela value 5 of 6, found '5O'"),
        (PLAIN.replace("50", "1e999"), 9, "found '1e999'"),
        (PLAIN.replace("50", "-50"), 9, "candela value 5 of 6, not negative, found '-50'"),
        (PLAIN.replace("0 45 90\n", "0 90 45\n"), 6, "expected vertical angle 3 of 3, ascending within 0 to 180 deg, found '45'"),
        (PLAIN.replace("0 90\n10", "90 0\n10"), 7, "expected horizontal angle 2 of 2, ascending"),
        (PLAIN.replace("2 1 2 0", "2 4 2 0"), 4, "expected the photometric type: 1 for C, 2 for B, 3 for A, found '4'"),
        (PLAIN.replace(" 3 2 1", " 3 -2 1"), 4, "expected the number of horizontal angles (a whole number, at least 1), found '-2'"),
        (PLAIN.replace("1 -1 1 3", "1 -1 0 3"), 4, "expected the candela multiplier, above 0, found '0'"),
        (PLAIN.replace("\n1 1 10", "\n-1 1 10"), 5, "expected the ballast factor, above 0, found '-1'"),
        (PLAIN[: PLAIN.index("\n1 1 10")], 4, "expected the ballast factor, found the file's end"),
        (PLAIN.replace("TILT=NONE", "TILT=INCLUDE\n1 2 0 90\n1 x"), 5, "tilt factor 2 of 2"),
    ],
)
def test_broken_files_name_the_line_and_what_was_expected(text, line, expected):
    with sentence(expected, f"lamp.ies, line {line}: "):
        parsed(text)


@pytest.mark.parametrize(("data", "words"), [(b"", "empty"), (b" \n ", "empty"), (b"\x89PNG\0\0", "binary"), (b"\xff\xfe\xfa", "TILT")])
def test_what_is_no_text_is_refused(data, words, tmp_path):
    (tmp_path / "lamp.ies").write_bytes(data)
    with refusal(words):
        read_photometry(tmp_path / "lamp.ies")


def test_a_missing_file_is_a_sentence(tmp_path):
    with refusal(r"lamp\.ies: cannot be read"):
        read_photometry(tmp_path / "lamp.ies")


def test_tilt_is_offered_and_not_applied(tmp_path):
    factors = "3\n2\n0 90\n1 0.5\n"
    for tilt in (f"TILT=INCLUDE\n{factors}", "TILT=C:\\lamps\\lamp.tlt\n"):
        (tmp_path / "lamp.ies").write_text(ies(V, H, TABLE, tilt=tilt))
        (tmp_path / "lamp.tlt").write_text(factors)
        p = read_photometry(tmp_path / "lamp.ies")
        assert p.tilt_factors is not None and p.tilt_factors.geometry == 3
        np.testing.assert_array_equal(p.tilt_factors.factors, [1, 0.5])
        np.testing.assert_array_equal(p.distribution.candela, TABLE)
    (tmp_path / "lamp.tlt").unlink()
    p = read_photometry(tmp_path / "lamp.ies")
    assert p.tilt_factors is None and "beside" in p.warnings[0]


def angles(low: int, high: int, fewest: int) -> st.SearchStrategy[list[float]]:
    tenths = st.lists(st.integers(10 * low, 10 * high), min_size=fewest, max_size=30, unique=True)
    return tenths.map(lambda each: [angle / 10 for angle in sorted(each)])


@st.composite
def distributions(draw: st.DrawFn) -> Distribution:
    kind = draw(st.sampled_from(["A", "B", "C"]))
    v = draw(angles(0 if kind == "C" else -90, 180 if kind == "C" else 90, 2))
    h = draw(angles(0 if kind == "C" else -90, 360 if kind == "C" else 90, 1))
    candela = draw(npst.arrays(np.float64, (len(h), len(v)), elements=st.floats(0, 1e6)))
    return Distribution(kind, np.array(v), np.array(h), candela)


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(distributions())
def test_what_is_written_is_read_back(tmp_path, d):
    write(tmp_path / "lamp.ies", d, {"LAMP": "one\ntwo"})
    p = read_photometry(tmp_path / "lamp.ies")
    assert (p.format, p.keywords["LAMP"], p.distribution.type, p.absolute) == ("LM-63-2019", "one\ntwo", d.type, True)
    np.testing.assert_array_equal(p.distribution.vertical_deg, d.vertical_deg)
    np.testing.assert_array_equal(p.distribution.horizontal_deg, d.horizontal_deg)
    np.testing.assert_allclose(p.distribution.candela, d.candela, rtol=5.1e-9)  # nine significant digits
    assert max(map(len, (tmp_path / "lamp.ies").read_text().splitlines())) <= 256
    assert not list(tmp_path.glob("*.part"))


def test_writing_to_nowhere_is_a_sentence(tmp_path):
    with refusal("cannot be written"):
        write(tmp_path / "no" / "lamp.ies", parsed(PLAIN).distribution)
    (tmp_path / "d.ies").mkdir()
    with refusal(r"d\.ies: cannot be written, because it is a folder"):
        write(tmp_path / "d.ies", parsed(PLAIN).distribution)
    assert [path.name for path in tmp_path.iterdir()] == ["d.ies"]
