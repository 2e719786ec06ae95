"""OpenCRG against elevations of the ASAM reference library, against itself, and with broken files."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from luxloop.world.opencrg import Crg, CrgSurface, fill_gaps, modify, read_crg
from tests.refusal import refusal
from tests.world.opencrg.writer import write_crg

# The library keeps elevations as float32 and its x, y are printed to 1e-9 m, so we differ by 2e-9 m at most; this is the promise.
TOLERANCE_M = 1e-6
SCANS = [
    "handmade_straight",
    "handmade_straight_double",
    "handmade_curved",
    "handmade_curved_banked_sloped",
    "derived_kdbi_curved_banked_sloped",
    "belgian_block",
    "Horstwalde",
    "halfround_4in",
    "detrended_rms_course_1in",
    "Barber",
]


@pytest.fixture(scope="session")
def reference(data_dir: Path) -> dict:
    return json.loads((data_dir / "roads" / "reference_z.json").read_text())["files"]


@pytest.fixture(params=SCANS)
def scan(request: pytest.FixtureRequest, data_dir: Path) -> Crg:
    return read_crg(data_dir / "roads" / f"{request.param}.crg")


def columns(rows: list[list[float | None]]) -> np.ndarray:
    return np.array(rows, dtype=float).T


def bordered(crg: Crg, mode: int) -> CrgSurface:
    return CrgSurface(replace(crg, options={**crg.options, "border_mode_u": mode, "border_mode_v": mode}))


def assert_close(actual: np.ndarray, expected: np.ndarray) -> None:
    assert_allclose(actual, expected, rtol=0, atol=TOLERANCE_M)


def test_agrees_with_the_reference_library(scan, reference):
    facts = reference[Path(scan.source).name]
    assert scan.z.shape == (facts["n_u"], facts["n_v"])
    assert np.isnan(scan.z).sum() == facts["nan_cells"]
    surface = bordered(scan, 0)
    u, v, z, x, y, u_back, v_back, z_back = columns(facts["inside"]["rows"])
    assert_close(surface.z(u, v), z)
    assert_close(np.stack(surface.xy(u, v)), np.stack([x, y]))
    assert_close(np.stack(surface.uv(x, y)), np.stack([u_back, v_back]))
    z_here = bordered(scan, 2).z(*surface.uv(x, y))
    # On the very border it is a matter of rounding x, y to 1e-9 m whether the point is inside: only there may the library have no value.
    on_border = np.isin(u, [surface.u_start, surface.u_end]) | np.isin(v, scan.v[[0, -1]])
    assert on_border[np.isnan(z_back) & ~np.isnan(z_here)].all()
    assert_close(np.where(np.isnan(z_back), np.nan, z_here), z_back)

    u, v, keep, zero = columns(facts["outside"]["rows"])
    assert_close(bordered(scan, 2).z(u, v), keep)
    assert_close(bordered(scan, 1).z(u, v), zero)
    if facts.get("nan_keep_last"):
        u, v, z = columns(facts["nan_keep_last"]["rows"])
        assert_close(CrgSurface(modify(replace(scan, modifiers={"grid_nan_mode": 2}))).z(u, v), z)
    if facts.get("modifiers_applied"):
        u, v, z, x, y = columns(facts["modifiers_applied"]["rows"])
        # what the library does without $ROAD_CRG_MODS: fill NaN, start at the origin with heading 0
        moved = CrgSurface(modify(replace(scan, modifiers=scan.modifiers or {"grid_nan_mode": 2, "refpoint_phi": 0.0})))
        assert_close(np.stack([moved.z(u, v), *moved.xy(u, v)]), np.stack([z, x, y]))


def test_a_closed_track_wraps(data_dir):
    track = CrgSurface(read_crg(data_dir / "roads" / "Barber.crg"))
    lap = track.u_end + float(np.hypot(*(track.points[0] - track.points[-1])))
    u, v = np.array([100.0, 2000.0]), np.array([1.0, -2.0])
    # The gap of 0.18 m is closed along the end's heading, 0.4 mm less than its length.
    assert_allclose(track.xy(u + lap, v), track.xy(u, v), atol=1e-2)
    assert_allclose(track.z(u + lap, v), track.z(u, v), atol=1e-3)


LINE = {"increment": 0.25, "start_u": 3.0, "start_x": 2.0, "start_phi": 0.3}


def grid(kind_of_line: str = "curved", n_u: int = 40, n_v: int = 6, seed: int = 1) -> Crg:
    rng = np.random.default_rng(seed)
    bent = kind_of_line == "curved"
    return Crg(
        z=rng.normal(0, 0.02, (n_u, n_v)),
        v=np.sort(rng.uniform(-2, 2, n_v)) if bent else -1.0 + 0.4 * np.arange(n_v),
        road={f"reference_line_{key}": value for key, value in LINE.items()},
        phi=0.3 + np.cumsum(rng.normal(0, 0.01, n_u)) if bent else None,
        slope=rng.normal(0, 0.02, n_u) if bent else None,
        banking=rng.normal(0, 0.02, n_u) if bent else None,
    )


@pytest.mark.parametrize(("kind", "tolerance"), [("KDBI", 0.0), ("KRBI", 1e-7), ("LDFI", 1e-16), ("LRFI", 1e-7)])
@pytest.mark.parametrize("kind_of_line", ["curved", "straight"])
def test_write_and_read_again(tmp_path, kind, tolerance, kind_of_line):
    crg = grid(kind_of_line)
    crg.z[5, :2] = np.nan
    crg = replace(crg, modifiers={"grid_nan_mode": 2.0}, options={"border_mode_u": 4.0})
    write_crg(tmp_path / "one.crg", crg, kind)
    once = read_crg(tmp_path / "one.crg")
    # float32 and ten characters both keep 7 digits of values below 1; twenty characters keep 17 decimals.
    assert_allclose(once.z, crg.z, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(once.v, crg.v)
    assert (once.modifiers, once.options) == (crg.modifiers, crg.options)
    write_crg(tmp_path / "two.crg", once, kind)
    assert (tmp_path / "two.crg").read_bytes() == (tmp_path / "one.crg").read_bytes()


@settings(max_examples=30)
@example(u=3.0, v=-1.2659479698433227, seed=0)  # rounding takes it before the line's start, where another heading counts
@given(u=st.floats(3.0, 12.7), v=st.floats(-1.5, 1.5), seed=st.integers(0, 20))
def test_xy_and_uv_are_inverse(u, v, seed):
    surface = CrgSurface(grid(seed=seed))
    assert_allclose(surface.uv(*surface.xy(u, v)), (u, v), atol=1e-9)


@pytest.mark.parametrize(("mode", "expected"), [(0, np.nan), (1, 0.5), (2, 3.5), (3, 0.5), (4, 2.5)])
def test_border_modes(mode, expected):
    ramp = Crg(z=np.arange(4.0)[:, None] * [1.0, 1.0], v=np.array([-1.0, 1.0]), road={"reference_line_increment": 1.0})
    surface = CrgSurface(replace(ramp, options={"border_mode_u": mode, "border_offset_u": 0.5}))
    assert float(surface.z(3.5, 0.0)) == pytest.approx(expected, nan_ok=True)


def test_smoothing_ramps_from_the_line():
    step = Crg(z=np.ones((11, 2)), v=np.array([-1.0, 1.0]), road={"reference_line_increment": 1.0}, options={"border_smooth_ubeg": 4.0})
    assert_allclose(CrgSurface(step).z([-1.0, 1.0, 2.0, 4.0, 9.0], 0.0), [0.0, 0.25, 0.5, 1.0, 1.0])


@pytest.mark.parametrize("given", [True, False])
def test_line_meets_its_end_if_given(given):
    road = {"reference_line_increment": 0.25, "reference_line_end_x": 9.0, "reference_line_end_y": 1.0, "reference_line_end_z": 0.4}
    crg = replace(grid(), road=road if given else {"reference_line_increment": 0.25})
    surface = CrgSurface(crg)
    assert tuple(surface.points[0]) == (0.0, 0.0)
    if given:
        assert_allclose([*surface.points[-1], surface.heights[-1]], [9.0, 1.0, 0.4], atol=1e-12)
    else:
        assert_allclose(np.linalg.norm(np.diff(surface.points, axis=0), axis=1), 0.25)


def test_modifiers_move_the_reference_point_and_keep_the_shape():
    crg = grid()
    mods = {"refpoint_u": 7.0, "refpoint_v": 0.3, "refpoint_x": 5.0, "refpoint_y": -2.0, "refpoint_z": 1.0, "refpoint_phi": 0.7}
    before, after = CrgSurface(crg), CrgSurface(modify(replace(crg, modifiers=mods)))
    assert_allclose([*after.xy(7.0, 0.3), after.z(7.0, 0.3), after.phi(7.0)], [5.0, -2.0, 1.0, 0.7], atol=1e-12)
    u, v = np.random.default_rng(0).uniform([[4.0], [-1.0]], [[11.0], [1.0]], (2, 50))
    assert_allclose(after.z(u, v) - before.z(u, v), 1.0 - before.z(7.0, 0.3), atol=1e-12)
    distances = [np.hypot(*(np.stack(s.xy(u, v)) - np.stack(s.xy(7.0, 0.3))[:, None])) for s in (before, after)]
    assert_allclose(*distances, atol=1e-12)


def test_modifiers_scale():
    crg = grid("straight")
    scaled = modify(replace(crg, modifiers={"scale_z_grid": 2.0, "scale_length": 3.0, "scale_width": 0.5}))
    np.testing.assert_array_equal(scaled.z, 2 * crg.z)
    np.testing.assert_array_equal(scaled.v, crg.v / 2)
    assert (scaled.u_start, scaled.u_end) == (crg.u_start, crg.u_start + 3 * (crg.u_end - crg.u_start))
    turned = CrgSurface(modify(replace(grid(), modifiers={"scale_curvature": 0.0})))
    assert_allclose(turned.phi(np.linspace(3.0, 12.7, 9)), 0.3)


def test_nan_is_filled_outwards():
    nan = np.nan
    crg = replace(grid("straight", 3, 4), z=np.array([[nan, 1, 2, nan], [nan] * 4, [nan, nan, 7, nan]]), v=np.arange(4.0))
    np.testing.assert_array_equal(fill_gaps(crg, 0.0).z[[0, 2]], [[1, 1, 2, 2], [7, 7, 7, 7]])
    np.testing.assert_array_equal(fill_gaps(crg, 0.5).z[0], [1.5, 1, 2, 2.5])
    assert np.isfinite(fill_gaps(crg).z).all()
    np.testing.assert_array_equal(modify(replace(crg, modifiers={"grid_nan_mode": 1})).z[0], [0, 1, 2, 0])


def test_a_file_may_refer_to_another(tmp_path):
    write_crg(tmp_path / "scan.crg", replace(grid(), modifiers={"scale_z_grid": 3.0, "grid_nan_mode": 2.0}), "KDBI")
    outer = tmp_path / "outer.crg"
    outer.write_text("$ROAD_CRG_FILE\n ./sc  ! split\n an.crg\n$ROAD_CRG_MODS\nSCALE_Z_GRID = 2.000000000+e00\n$\n")
    crg = read_crg(outer)
    assert crg.modifiers == {"scale_z_grid": 2.0, "grid_nan_mode": 2.0}
    np.testing.assert_array_equal(crg.z, grid().z)
    outer.write_text("$ROAD_CRG_FILE\nouter.crg\n$\n")
    with refusal("circle"):
        read_crg(outer)


@pytest.mark.parametrize("path", ["$SECRET/scan.crg", "${SECRET}.crg", "/nowhere/$SECRET"])
def test_a_reference_shows_no_environment_variable(tmp_path, monkeypatch, path):
    monkeypatch.setenv("SECRET", "hunter2")
    outer = tmp_path / "outer.crg"
    outer.write_text(f"$ROAD_CRG_FILE\n {path}\n$\n")
    with refusal(r"outer\.crg: .*\$\{?SECRET.*not expanded; write the path out") as caught:
        read_crg(outer)
    assert "hunter2" not in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "old", "new", "message"),
    [
        ("KDBI", b"$ROAD_CRG", b"$ROAD_XYZ", "is not an OpenCRG file"),
        ("KDBI", b"$KD_DEFINITION", b"$KD", "no \\$KD_DEFINITION"),
        ("KDBI", b"#:KDBI", b"#:KDBX", r"line \d+: data kind 'KDBX' is unknown"),
        ("KDBI", b"REFERENCE_LINE_INCREMENT", b"REFERENCE_LINE_INCREMENTS", "needs REFERENCE_LINE_INCREMENT"),
        ("KDBI", b"= 0.25", b"= -0.25", "needs REFERENCE_LINE_INCREMENT"),
        ("KDBI", b"END_U      = 12.75", b"END_U      = 2.75", "REFERENCE_LINE_END_U lies before"),
        ("KDBI", b"long section 3", b"long section at v = 3", "mixes long sections"),
        ("KDBI", b"long section 3", b"long section 9", "not numbered 1 to 6"),
        ("KDBI", b"V_LEFT       = 1.0", b"V_LEFT       = 1.9", "do not end at 1.9 m; correct .*V_LEFT"),
        ("KDBI", b"#:KDBI", b"# :LDFI", r"line \d+: has \d+ characters"),
        ("LRFI", b"#:LRFI", b"#:KRBI", "its data block is text, but .* declares KRBI"),
        ("KRBI", b"#:KRBI", b"#:KDBI", "as long as that of .* rows of KRBI, not KDBI"),
        ("LRFI", b"D:long section 6,m\n", b"", r"line \d+: has more than the 5 values"),
        ("LRFI", b"0\n 0.25", b"0 0.25", r"line \d+: has 120 characters, and LRFI data 80 at most"),
        ("LRFI", b"section 6,m", b"section 6,furlong", r"line \d+: the unit 'furlong' is unknown"),
        ("LRFI", b"section 6,m", b"section 6,m,cm", r"line \d+: .* has more than a name and a unit"),
        ("LRFI", b"_PHI  ", b"_PHI = 90 !", r"line \d+: REFERENCE_LINE_START_PHI = 90 rad is more than a turn"),
        ("LRFI", b"D:long section 6,m", b"D:reference line heading,rad", r"line \d+: .* no channel of a reference line"),
        ("LRFI", b"= 0.25", b"= 0,25", r"line \d+: the unit ',25' is unknown"),
        ("LRFI", b"\n 0.25", b"\n 0,25", r"line \d+: .* is not a number in a fixed column"),
    ],
)
def test_broken_files_say_what_and_where(tmp_path, kind, old, new, message):
    path = tmp_path / "bad.crg"
    write_crg(path, replace(grid("straight"), z=np.full((40, 6), 0.25)), kind)
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1))
    with refusal(message) as caught:
        read_crg(path)
    assert str(path) in str(caught.value)


CM, INCH, DEGREE = 0.01, 0.0254, np.pi / 180


@pytest.mark.parametrize("kind", ["LRFI", "LDFI", "KRBI", "KDBI"])
@pytest.mark.parametrize(
    ("channel", "unit", "one"),
    [("z", "CM", CM), ("z", " [in] ", INCH), ("phi", "deg", DEGREE), ("slope", "%", 0.01), ("banking", "mm/m", 1e-3)],
)
def test_units_are_converted(kind, channel, unit, one, tmp_path):
    crg = grid("straight")
    crg = replace(crg, **{channel: getattr(crg, channel) if channel == "z" else np.linspace(0.001, 0.002, len(crg.z))})
    value = getattr(crg, channel)
    write_crg(tmp_path / "a.crg", replace(crg, **{channel: value / one}), kind)
    named = {"z": b"m", "phi": b"rad"}.get(channel, b"m/m")
    head, mark, data = (tmp_path / "a.crg").read_bytes().partition(b"$" * 72)
    (tmp_path / "a.crg").write_bytes(head.replace(b"," + named + b"\n", f",{unit}\n".encode()) + mark + data)
    # float32, and 10 characters, hold 7 digits of the value as it is stored
    assert_allclose(getattr(read_crg(tmp_path / "a.crg"), channel), value, rtol=0, atol=1e-5 * one + 1e-7)


def test_header_numbers_have_units_and_sections_an_increment_from_their_ends(tmp_path):
    write_crg(tmp_path / "a.crg", replace(grid("straight"), z=np.full((40, 6), 0.25)))
    data = (tmp_path / "a.crg").read_bytes()
    for old, new in ((b"= -1.0", b"= -100 cm"), (b"= 0.3", b"= 30 [DEG]"), (b"LONG_SECTION_V_INCREMENT", b"NO")):
        assert old in data
        data = data.replace(old, new)
    (tmp_path / "a.crg").write_bytes(data)
    crg = read_crg(tmp_path / "a.crg")
    assert_allclose(crg.v, np.linspace(-1, 1, 6), atol=1e-12)
    assert crg.line("start_phi") == pytest.approx(np.pi / 6)


def test_damaged_binary_is_refused(tmp_path):
    path = tmp_path / "bad.crg"
    crg = replace(grid("straight"), z=np.full((40, 6), np.float32(2.1025)))  # holds no CR LF
    crg.z[7, 3] = np.frombuffer(b"\x3f\x0d\x0a\x01", ">f4")[0]
    write_crg(path, crg, "KRBI")
    content = path.read_bytes()
    path.write_bytes(content[:-333])
    with refusal("truncated"):
        read_crg(path)
    path.write_bytes(content.replace(b"\r\n", b"\n"))
    with refusal(r"implausible|truncated"):
        read_crg(path)
    path.write_bytes(content.replace(b"\n", b"\r\n"))
    with refusal("implausible"):
        read_crg(path)
    path.write_bytes(content[: -240 - 80 * 2])
    with pytest.warns(UserWarning, match="of the 40 rows"):
        assert len(read_crg(path).z) < 40


def test_not_a_crg(tmp_path):
    path = tmp_path / "noise.crg"
    path.write_bytes(np.random.default_rng(0).bytes(5000))
    with refusal("is not an OpenCRG file"):
        read_crg(path)
    with refusal("cannot be read"):
        read_crg(tmp_path / "none.crg")


NO_ROAD = r"are not those of a road; correct \$ROAD_CRG and \$ROAD_CRG_MODS"
LARGE = ("scale_length", "scale_width", "scale_z_grid", "scale_curvature", "refpoint_x", "refline_offset_z")


@pytest.mark.parametrize(
    ("modifier", "value", "words"),
    [
        *((name, value, rf"a\.crg, line \d+: {name.upper()} = .* too large for a road") for name in LARGE for value in (1e300, -1e300)),
        *((name, value, NO_ROAD) for name, value in zip(LARGE[:4], (1e-300, 1e9, -1e9, 1e9), strict=True)),
    ],
)
def test_modifiers_of_no_road_are_refused_in_a_sentence(modifier, value, words, tmp_path):
    phi = np.linspace(0.0, 0.2, 9)
    crg = Crg(np.full((9, 3), 0.2), np.array([-1.0, 0.0, 1.0]), {"reference_line_increment": 0.5}, phi, modifiers={modifier: value})
    write_crg(tmp_path / "a.crg", crg)
    with refusal(words):
        CrgSurface(modify(read_crg(tmp_path / "a.crg")))
