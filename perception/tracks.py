"""What a tracker knows after a frame: a value, so that it can be kept, sent and taken up anywhere."""

from dataclasses import dataclass, replace

from torch import Tensor


@dataclass(frozen=True, eq=False)
class Tracks:
    """All tracks after a frame, at time_s; n of them, C classes. following: the number that the next new one gets.

    number: `[n]`, the identity. mean: `[n, 2, 2]`, u and v of the foot in px and their rates a second. covariance: `[n, 2, 2, 2]`.
    size_m: `[n, 2]`, width and height. frames: `[n]` that showed it. since_s, seen_s, until_s: `[n]`, when it was confirmed, last found and
    lost; inf: not yet. category: `[n]`, index of its class. confidence: `[n, C]`, filtered. score: `[n, C]` in this frame, NaN where it was
    not found.
    """

    time_s: float
    number: Tensor
    mean: Tensor
    covariance: Tensor
    size_m: Tensor
    frames: Tensor
    since_s: Tensor
    seen_s: Tensor
    until_s: Tensor
    category: Tensor
    confidence: Tensor
    score: Tensor
    following: int

    def __len__(self) -> int:
        return len(self.number)

    def take(self, which: Tensor) -> "Tracks":
        """Those of indices or of a mask."""
        return replace(self, **{name: getattr(self, name)[which] for name in EACH})

    @property
    def known(self) -> "Tracks":
        """Those that are confirmed, the lost ones among them."""
        return self.take(self.since_s.isfinite())

    @property
    def present(self) -> "Tracks":
        """Those that are confirmed and not lost."""
        return self.take(self.since_s.isfinite() & self.until_s.isinf())


EACH = ("number", "mean", "covariance", "size_m", "frames", "since_s", "seen_s", "until_s", "category", "confidence", "score")
