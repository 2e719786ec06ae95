"""Lamp files: read bit for bit, and refused where they are foreign, damaged or do not fit together."""

import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from luxloop.world.errors import LuxloopError
from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Lamp, Module
from luxloop.world.lamps.archive import load, save
from luxloop.world.spmv import Csr
from tests.refusal import refusal, sentence


def headlight(dtype: torch.dtype, coloured: bool) -> Headlight:
    generator = np.random.default_rng(0)
    matrix = Csr.from_scipy(sp.random_array((12, 6), density=0.5, rng=generator) * 1e4, dtype)
    chroma = torch.from_numpy(generator.random((3, len(matrix.values)))).to(dtype) if coloured else None
    borders = {"left": 0.1, "right": -1 / 3, "bottom": -0.2, "top": 0.07}
    return Headlight(name="a headlight", rows=3, cols=4, matrix=matrix, pixel_rows=2, pixel_cols=3, chroma=chroma, **borders)


@pytest.fixture(scope="module")
def lamp() -> Lamp:
    pose = pose_from_degrees((0.01, -0.2, 1 / 7), 1.0, -0.3, 0.1).double()
    modules = (
        Module("matrix", headlight(torch.float32, False)),
        Module("Füllicht", headlight(torch.float32, True), pose, (-5.0, 12.5), (-1.0, 0.5)),
    )
    beams = {"low beam": (torch.rand(6), torch.rand(6)), "town": (torch.zeros(6), torch.ones(6))}
    return Lamp("two modules", modules, beams, "Measured on a bench.\nOne pixel is guessed.")


def data(lamp: Lamp) -> tuple[Any, ...]:
    """All of a lamp, bit for bit, dtypes included."""

    def plain(fields: list[tuple[str, Any]]) -> dict[str, Any]:
        return {name: (value.dtype, value.tolist()) if isinstance(value, torch.Tensor) else value for name, value in fields}

    beams = {name: [(u.dtype, u.tolist()) for u in us] for name, us in lamp.beams.items()}
    return lamp.name, lamp.notes, beams, [asdict(module, dict_factory=plain) for module in lamp.modules]


@pytest.fixture(scope="module")
def content(lamp: Lamp, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("lamps") / "lamp.npz"
    save(path, lamp)
    return path.read_bytes()


def test_round_trip_is_exact(lamp, tmp_path):
    light = lamp.modules[0].headlight
    save(tmp_path / "lamp.npz", lamp)
    loaded = load(tmp_path / "lamp.npz")
    assert data(lamp) == data(loaded)
    assert torch.equal(loaded.modules[0].headlight.light_texture(torch.ones(6)), light.light_texture(torch.ones(6)))
    assert [path.name for path in tmp_path.iterdir()] == ["lamp.npz"]


def test_numpy_alone_reads_it(content):
    with np.load(io.BytesIO(content)) as arrays:
        header = json.loads(arrays["header"].tobytes())
        assert arrays["module0_indices"].dtype == np.int32
    assert (header["format"], header["version"], header["beams"]) == ("luxloop lamp", 1, ["low beam", "town"])


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(drawn=st.data())
def test_damage_is_noticed(lamp, content, tmp_path, drawn):
    """A broken copy is refused, or (a flipped bit of a date, say) gives the same lamp."""
    path = tmp_path / "broken.npz"
    if drawn.draw(st.booleans()):
        broken = content[: drawn.draw(st.integers(0, len(content) - 1))]
    else:
        changed = bytearray(content)
        for at in drawn.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=3)):
            changed[at] ^= drawn.draw(st.integers(1, 255))
        broken = bytes(changed)
    path.write_bytes(broken)
    try:
        loaded = load(path)
    except LuxloopError as error:
        assert "broken.npz" in str(error)
    else:
        assert data(lamp) == data(loaded)


def rewritten(content: bytes, change: Callable[[dict[str, Any]], None]) -> bytes:
    """The file with its header and arrays changed, check sums right again."""
    with np.load(io.BytesIO(content)) as archive:
        arrays = dict(archive)
    arrays["header"] = json.loads(arrays["header"].tobytes())
    change(arrays)
    arrays["header"] = np.frombuffer(json.dumps(arrays["header"]).encode(), np.uint8)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a: a["header"].update(version=2, luxloop="9.0"), "written by luxloop 9.0 as version 2"),
        (lambda a: a["header"]["modules"][0].update(left=-1), "wrong order"),
        (lambda a: a["header"]["modules"][0].update(rows=5), "module0_indptr is not what the header says"),
        (lambda a: a["module1_indices"].__setitem__(0, 6), "module1_indices"),
        (lambda a: a["module1_indptr"].__setitem__(1, 99), "module1_indptr"),
        (lambda a: a["module1_values"].__setitem__(0, np.nan), "module1_values"),
        (lambda a: a["module0_beam0"].__setitem__(0, 1.5), "module0_beam0"),
        (lambda a: a.update(module0_values=a["module0_values"].astype(np.float64)), "module0_values"),
        (lambda a: a["module0_values"].__setitem__(0, -1), "module0_values"),
        (lambda a: a.update(module0_pose=np.diag([1.0, -1, 1, 1])), "module0_pose"),
        (lambda a: a["header"]["modules"][1].update(swivel_deg=[5, -5]), "swivel_deg = 5 to -5 is in the wrong order"),
        (lambda a: a["header"]["modules"][1].update(name="matrix"), "module 'matrix' occurs twice"),
        (lambda a: a["header"].update(beams=["town", "town"]), "beam 'town' occurs twice"),
        (lambda a: a["header"].update(beams=["low beam", "full"]), "beam 'full' occurs twice (every lamp has it)"),
        (lambda a: a.pop("module0_values"), "module0_values"),
        (lambda a: a["header"]["modules"][0].update(rows=10**9, cols=10**9), "module 'matrix' would take"),
    ],
)
def test_what_does_not_fit_together_is_refused(content, tmp_path, change, words):
    (tmp_path / "odd.npz").write_bytes(rewritten(content, change))
    with sentence(words, "odd.npz"):
        load(tmp_path / "odd.npz")


def test_foreign_files_are_refused(tmp_path):
    np.savez(tmp_path / "foreign.npz", a=np.ones(3))
    (tmp_path / "text.npz").write_text("IESNA:LM-63-2002")
    np.savez(tmp_path / "pickle.npz", header=np.array([{"a": 1}], dtype=object))
    with zipfile.ZipFile(tmp_path / "zip.npz", "w") as archive:
        archive.writestr("header.npy", b"no array")
    for name, words in {
        "foreign": "no header",
        "text": "no lamp file",
        "pickle": "no lamp file",
        "zip": "no lamp file",
        "gone": "cannot",
    }.items():
        with sentence(words):
            load(tmp_path / f"{name}.npz")


def test_writing_names_what_is_wrong_and_leaves_nothing_behind(lamp, tmp_path):
    with refusal(r"ends in \.npz"):
        save(tmp_path / "lamp.toml", lamp)
    with refusal("cannot be written"):
        save(tmp_path / "no folder" / "lamp.npz", lamp)
    with refusal("beam 'off' occurs twice"):
        save(tmp_path / "lamp.npz", replace(lamp, beams={"off": lamp.beams["town"]}))
    assert list(tmp_path.iterdir()) == []
