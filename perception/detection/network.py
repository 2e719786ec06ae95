"""A small convolutional network that detects objects as centres and box sides relative to them (CenterNet, Zhou et al. 2019)."""

import io
import math
import pickletools
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, max_pool2d

from luxloop.perception.detection.detector import Detections, suppress
from luxloop.world.files import afford, reading
from luxloop.world.traffic.tracked import Category

STRIDE = 8  # px of the frame per cell of the output
CODE = 0.75  # exponent on the light: between 1, where dark clothes vanish beside bright ones, and 0.5, where shot noise is uniform
CANDIDATES = 64  # the most objects in a frame
# The only names allowed in a file of weights; others could run code or, as bytearray(N), allocate memory.
NAMES = {"collections OrderedDict", "torch._utils _rebuild_tensor_v2", "torch HalfStorage", "torch FloatStorage", "torch LongStorage"}


class Network(nn.Module):
    """From frames `[B, 1, height, width]`, as from `prepared`, to class logits and box sides in cells of 8 x 8 px.

    The network works at scales of 2 to 32 px and adds coarser features to finer features.
    """

    def __init__(self, classes: int) -> None:
        super().__init__()
        self.fine = nn.Sequential(_conv(1, 16, 2), _conv(16, 32, 2), _conv(32, 32))
        self.middle = nn.Sequential(_conv(32, 48, 2), _conv(48, 48))
        self.coarse = nn.Sequential(_conv(48, 64, 2), _conv(64, 64))
        self.coarsest = nn.Sequential(_conv(64, 96, 2), _conv(96, 96), nn.Conv2d(96, 64, 1))
        self.joined_coarse = nn.Sequential(_conv(64, 64), nn.Conv2d(64, 48, 1))
        self.joined = nn.Sequential(_conv(48, 48), _conv(48, 64))
        self.head = nn.Conv2d(64, classes + 4, 1)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def expect(self, share: float) -> None:
        """Initialise the biases before training: objects in this share of the cells, boxes of about 40 px."""
        assert self.head.bias is not None
        nn.init.constant_(self.head.bias[:-4], math.log(share / (1 - share)))
        nn.init.constant_(self.head.bias[-4:], 1.0)

    @torch.no_grad()
    def calibrate(self, slope: float, shift: float) -> None:
        """Scale and shift the logits from now on."""
        assert self.head.bias is not None
        self.head.weight[:-4] *= slope
        self.head.bias[:-4] = slope * self.head.bias[:-4] + shift

    def forward(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        """Logits `[B, classes, rows, columns]`, and distances in px from a cell's centre to left, top, right, bottom `[B, 4, rows,
        columns]`, above 0.
        """
        middle = self.middle(self.fine(frames))
        coarse = self.coarse(middle)
        coarse = coarse + _spread(self.coarsest(coarse), coarse)
        out = self.head(self.joined(middle + _spread(self.joined_coarse(coarse), middle)))
        return out[:, :-4], STRIDE * out[:, -4:].clamp(-4, 5).exp()


def _conv(channels: int, out: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(channels, out, 3, stride, 1, bias=False), nn.BatchNorm2d(out), nn.ReLU(inplace=True))


def _spread(coarse: Tensor, fine: Tensor) -> Tensor:
    return interpolate(coarse, size=fine.shape[-2:], mode="nearest")


def network_input(frames: Tensor) -> Tensor:
    """Input of the network `[B, 1, height, width]` from frames `[B, height, width]` in 0..1."""
    return frames.float().clamp(min=0).pow(CODE)[:, None].contiguous(memory_format=torch.channels_last)


def middles(rows: int, columns: int, device: torch.device) -> Tensor:
    """Middles of the cells, `[2, rows, columns]` px: to the right, down."""
    y, x = torch.meshgrid(torch.arange(rows, device=device), torch.arange(columns, device=device), indexing="ij")
    return (torch.stack([x, y]) + 0.5) * STRIDE


def boxes_of(sides: Tensor) -> Tensor:
    """Boxes `[B, 4, rows, columns]` px from sides of the same shape."""
    rows, columns = sides.shape[-2:]
    at = middles(rows, columns, sides.device)
    return torch.cat([at - sides[:, :2], at + sides[:, 2:]], 1)


@dataclass(frozen=True, eq=False)
class NetworkDetector:
    """The network with its weights. threshold: least score. overlap: IoU above which the box of lower score is suppressed."""

    network: Network
    classes: tuple[Category, ...]
    threshold: float
    overlap: float

    @torch.inference_mode()
    def detect(self, frames: Tensor) -> Sequence[Detections]:
        """See `Detector`. A cell counts if its score is the highest among its eight neighbours."""
        height, width = frames.shape[-2:]
        device = next(self.network.parameters()).device
        logits, sides = self.network(network_input(frames.to(device)))
        scores = logits.sigmoid()
        best = scores.amax(1)
        peak = torch.where(best == max_pool2d(best, 3, 1, 1), best, 0).flatten(1)
        chosen = peak.topk(min(CANDIDATES, peak.shape[1])).indices
        boxes, scores = (each.flatten(2).gather(2, chosen[:, None].expand(-1, each.shape[1], -1)).mT for each in (boxes_of(sides), scores))
        boxes = torch.minimum(boxes.clamp(min=0), torch.tensor([width, height, width, height]).to(boxes))
        kept = ~suppress(boxes, self.overlap) & (peak.gather(1, chosen) >= self.threshold)
        return [Detections(boxes[k][kept[k]], scores[k][kept[k]]) for k in range(len(frames))]


def load(file: Path, device: torch.device) -> tuple[Network, tuple[Category, ...]]:
    """The network from a file that `save` wrote, and its classes. Raises LuxloopError for any other file."""
    with reading(file, "holds no weights of this network", "take a file that `luxloop train-detector` wrote"):
        with zipfile.ZipFile(file) as archive:
            afford(f"{file}: its weights", 2 * sum(entry.file_size for entry in archive.infolist()), "train them anew")
            for entry in archive.namelist():
                if entry.endswith(".pkl") and (foreign := _names(archive.read(entry)) - NAMES):
                    raise ValueError(f"it names {foreign.pop()}")
        stored = torch.load(file, map_location=device, weights_only=True)
        if not isinstance(stored, dict):
            raise ValueError("it holds no table of weights")
        classes = tuple(stored["classes"])
        if not classes or len(set(classes)) < len(classes) or not set(classes) <= set(get_args(Category)):
            raise ValueError(f"its classes are not some of {', '.join(get_args(Category))}")
        network = Network(len(classes))
        network.load_state_dict(stored["weights"])
        if not all(each.isfinite().all() for each in network.state_dict().values()):
            raise ValueError("some of its weights are not finite")
    return network.to(device).eval(), classes


def _names(pickled: bytes) -> set[str]:
    """Names that a pickle imports, or the opcode where a name is computed."""
    found = ((opcode.name, text) for opcode, text, _ in pickletools.genops(pickled))
    return {str(text or name) for name, text in found if "GLOBAL" in name or name in ("INST", "EXT1", "EXT2", "EXT4")}


def save(network: Network, classes: Sequence[Category], file: Path) -> None:
    """Write the weights in half precision, with their classes."""
    weights: Mapping[str, Any] = network.state_dict()
    halves = {name: each.half() if each.is_floating_point() else each for name, each in weights.items()}
    content = io.BytesIO()  # torch reports a full disk without its reason
    torch.save({"classes": list(classes), "weights": halves}, content)
    file.write_bytes(content.getvalue())
