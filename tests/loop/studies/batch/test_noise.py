"""Noise of many windows at once is that of each frame, bit for bit."""

import torch

from luxloop.loop.studies.batch.noise import normal
from luxloop.loop.studies.batch.windows import Windows
from luxloop.perception.extraction import Crop
from luxloop.perception.noise import FrameNoise


def test_windows_of_noise_are_parts_of_the_frames() -> None:
    crops = [Crop(3, 60, 5, 90), Crop(0, 40, 0, 70), Crop(70, 99, 40, 101), Crop(0, 0, 0, 0)]
    windows = Windows.around(crops, (99, 101))
    assert windows.empty == (False, False, False, True) and any(u % 2 for _, u in windows.starts)
    frames = [FrameNoise.of(seed, 7, seed % 2) for seed in range(len(crops))]
    found = normal(frames, windows, torch.zeros(()))
    for frame, part, (v, u) in zip(frames, found, windows.starts, strict=True):
        whole = frame.part((slice(0, 99), slice(0, 101)), part)
        assert torch.equal(part, whole[v : v + windows.height, u : u + windows.width])
