"""luxloop's own network with the weights that are shipped."""

import io
import os
import zipfile
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from luxloop.perception.detection import network as network_file
from luxloop.perception.detection.build import detector
from luxloop.perception.detection.detector import NetworkParams, overlaps
from luxloop.perception.detection.network import STRIDE, Network, NetworkDetector, boxes_of, load, middles, save
from tests.refusal import refusal

SURE = 0.5


@pytest.fixture
def network(device: torch.device) -> NetworkDetector:
    found = detector(NetworkParams(), device)
    assert isinstance(found, NetworkDetector)
    return found


def test_what_is_easily_seen_is_found_in_its_class_by_light_and_not_in_the_dark(network, lit):
    bright, dark = network.detect(torch.cat([lit.frame(10.0), lit.frame(0.02)]))
    overlap = overlaps(torch.tensor([each.box for each in lit.clear]), bright.boxes.cpu())
    is_found = overlap.amax(1) > 0.5
    assert len(lit.clear) >= 5 and is_found.sum() >= len(lit.clear) - 1
    labels = torch.tensor([each.label for each in lit.clear])
    assert torch.equal(bright.scores[overlap.argmax(1)].argmax(1).cpu()[is_found], labels[is_found])
    assert not (dark.scores > SURE).any()


def test_light_raises_the_score_of_who_does_not_shine(network, lit):
    people, means = lit.boxes(0), []
    for found in network.detect(torch.cat([lit.frame(lx) for lx in (0.02, 0.3, 10.0)])):
        on_them = overlaps(people, found.boxes.cpu()) > 0.4
        scores = torch.where(on_them, found.scores[:, 0].cpu(), 0)
        means.append(float(torch.cat([scores, torch.zeros(len(people), 1)], 1).amax(1).mean()))
    assert means[0] < means[1] < means[2]


def test_a_batch_is_its_frames_one_by_one(network, lit):
    frames = torch.cat([lit.frame(lx) for lx in (2.0, 10.0, 40.0)])
    for together, frame in zip(network.detect(frames), frames, strict=True):
        (alone,) = network.detect(frame[None])
        # sums in another order
        torch.testing.assert_close(together.scores, alone.scores, atol=1e-4, rtol=1e-3)
        torch.testing.assert_close(together.boxes, alone.boxes, atol=0.02, rtol=1e-3)


def test_the_surest_is_first_and_boxes_lie_in_the_frame(network, lit):
    (found,) = network.detect(lit.frame(20.0)[:, 20:, 60:])
    best = found.scores.amax(1)
    assert len(found) and torch.equal(best, best.sort(descending=True).values) and (best >= 0.1).all()
    assert (found.boxes >= 0).all() and (found.boxes.cpu() <= torch.tensor([580.0, 340, 580, 340])).all()


def test_darkness_is_no_error(network):
    (found,) = network.detect(torch.zeros(1, 360, 640))
    assert found.boxes.shape == (0, 4) and found.scores.shape == (0, 4)


@pytest.mark.parametrize("size", [(360, 640), (181, 323)])
def test_cells_tile_the_frame(size):
    logits, sides = Network(3).eval()(torch.rand(2, 1, *size))
    rows, columns = (-(-side // STRIDE) for side in size)
    assert logits.shape == (2, 3, rows, columns) and (sides > 0).all()
    at = middles(rows, columns, torch.device("cpu"))
    assert at[:, 0, 0].tolist() == [4.0, 4.0] and at[:, 1, 2].tolist() == [20.0, 12.0]
    boxes: Tensor = boxes_of(sides)
    torch.testing.assert_close((at - boxes[:, :2]), sides[:, :2], atol=1e-3, rtol=1e-3)  # of positions up to 640 px in float32


def test_weights_are_stored_in_half_precision(tmp_path, device):
    network, frames = Network(2).eval(), torch.rand(1, 1, 64, 96)
    save(network, ("car", "animal"), tmp_path / "weights.pt")
    again, classes = load(tmp_path / "weights.pt", device)
    assert classes == ("car", "animal")
    assert (tmp_path / "weights.pt").stat().st_size < 1e6
    # 2^-11 of each weight, through twelve layers
    torch.testing.assert_close(again(frames.to(device))[0].cpu(), network(frames)[0], atol=0.02, rtol=0.02)


def stored(value: Any) -> bytes:
    buffer = io.BytesIO()
    torch.save(value, buffer)
    return buffer.getvalue()


def unpacking(value: bytes) -> bytes:
    """An archive of next to nothing that unpacks to 2 GB."""
    buffer = io.BytesIO(value)
    with (
        zipfile.ZipFile(buffer, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("archive/data/0", "w", force_zip64=True) as entry,
    ):
        for _ in range(20):
            entry.write(bytes(100_000_000))
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (lambda: stored(torch.zeros(3)), "holds no weights"),
        (lambda: stored({"classes": ["martian"], "weights": {}}), "its classes are not some of"),
        (lambda: stored({"classes": [], "weights": {}}), "its classes are not some of"),
        (lambda: stored({"classes": 5, "weights": {}}), "holds no weights"),
        (lambda: b"no archive", r"holds no weights .*luxloop train-detector"),
        (lambda: unpacking(stored({})), "its weights would take"),
    ],
)
def test_weights_of_something_else_are_told_in_a_sentence(given, words, tmp_path):
    file = tmp_path / "a.pt"
    file.write_bytes(given())
    with refusal(words):
        load(file, torch.device("cpu"))


class Call:
    """Pickles as a call."""

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.call = function, arguments

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self.call


@pytest.mark.parametrize("checked", [True, False])
def test_weights_run_no_code_and_take_no_memory_by_a_number(checked, tmp_path, monkeypatch):
    """Neither by what their pickle names nor, where that is not checked, in torch."""
    file, made = tmp_path / "a.pt", tmp_path / "made"
    if not checked:
        monkeypatch.setattr(network_file, "NAMES", {"posix mkdir"})
    else:
        file.write_bytes(stored({"classes": ["car"], "weights": Call(bytearray, 10**12)}))
        with refusal(r"holds no weights .*bytearray"):
            load(file, torch.device("cpu"))
    file.write_bytes(stored(Call(os.mkdir, str(made))))
    with refusal(r"holds no weights .*mkdir"):
        load(file, torch.device("cpu"))
    assert not made.exists()


def test_weights_that_are_not_finite_are_refused(tmp_path):
    network = Network(1)
    with torch.no_grad():
        network.head.weight[0] = float("nan")
    save(network, ("car",), tmp_path / "a.pt")
    with refusal("not finite"):
        load(tmp_path / "a.pt", torch.device("cpu"))
