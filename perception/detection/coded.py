"""8-bit gamma-coded images for detectors that are trained on photographs."""

import numpy as np
from torch import Tensor


def encode(frame: Tensor, gamma: float) -> np.ndarray:
    """Levels 0..255 `[height, width]` uint8 of a frame `[height, width]` in 0..1."""
    picture: np.ndarray = frame.float().clamp(0, 1).pow(1 / gamma).mul(255).round().byte().cpu().numpy()
    return picture
