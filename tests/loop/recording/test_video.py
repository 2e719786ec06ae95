"""Videos: pictures that show what they say, in a file that players read, there whole or not at all."""

from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
import torch

from luxloop import LuxloopError, ProjectionCommand, Simulation
from luxloop.loop.recording.video import Picture, VideoWriter, tone_map
from luxloop.loop.report.picture import LOST_RGB, SEEN_RGB, TARGET_RGB, frame_picture, white_of
from luxloop.loop.simulation.result import StepResult


def decoded(file: Path) -> list[np.ndarray]:
    with av.open(str(file)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def shows(picture: np.ndarray, rgb: tuple[int, int, int]) -> bool:
    """Whether a colour is there, be it thinned by anti-aliasing: the picture is grey else."""
    tint = np.array(rgb, float) - np.mean(rgb)
    colour = picture - picture.mean(-1, keepdims=True)
    strength = colour @ tint / (tint @ tint)
    return bool(((strength > 0.5) & (np.abs(colour - strength[..., None] * tint).max(-1) < 10)).any())


def drawn(result: StepResult, simulation: Simulation) -> Picture:
    return frame_picture(result, simulation, white_of(result, simulation))


def test_picture_has_the_cameras_size_and_shows_symbol_and_target(small_simulation, small_results):
    picture = drawn(small_results[-1], small_simulation)
    assert picture.shape == (180, 320, 3) and picture.dtype == np.uint8
    between = picture[90:130]  # insets and captions
    assert shows(between, SEEN_RGB) and shows(between, TARGET_RGB) and shows(picture[:90, :60], TARGET_RGB)
    result = small_results[0]
    seen = result.symbol.measurement
    bare = replace(result, held={"symbol": replace(result.symbol, measurement=replace(seen, symbol=torch.zeros_like(seen.symbol)))})
    v, u = np.nonzero((drawn(result, small_simulation) != drawn(bare, small_simulation)).any(-1))
    crop, (lit_v, lit_u) = seen.crop, torch.nonzero(seen.symbol > 0.5).T
    assert (v.min(), v.max()) == (int(lit_v.min()) + crop.v_start, int(lit_v.max()) + crop.v_start), "its outline is where it is"
    assert (u.min(), u.max()) == (int(lit_u.min()) + crop.u_start, int(lit_u.max()) + crop.u_start)


def test_lost_frames_are_a_dark_picture_that_says_so(small_simulation, small_results):
    result = small_results[0]
    seen = small_simulation.symbol.sensor.measure(None, ProjectionCommand(result.symbol.pose), small_simulation.symbol.projector.resting)
    none, held = replace(result.perception, image=None), {"symbol": replace(result.symbol, measurement=seen)}
    lost = replace(result, perception=none, control=replace(result.control, frames=None), held=held)
    picture = drawn(lost, small_simulation)
    assert not shows(picture, SEEN_RGB)
    assert shows(picture[-12:, :80], LOST_RGB)


def test_tone_map_is_monotonic_and_saturates_at_white():
    grey = tone_map(torch.tensor([[0.0, 0.01, 0.25, 1.0, 5.0]]), torch.tensor(1.0))
    assert grey[0, :, 0].tolist() == [0, 26, 128, 255, 255]


@pytest.mark.parametrize("size", [(320, 180), (65, 33)])
def test_video_has_every_picture_in_even_size(tmp_path, size):
    width, height = size
    shades = [40, 120, 200]
    with VideoWriter(tmp_path / "video.mp4", 10, size) as video:
        for shade in shades:
            video.add(np.full((height, width, 3), shade, np.uint8))
            assert not (tmp_path / "video.mp4").exists()
    pictures = decoded(tmp_path / "video.mp4")
    assert [picture.shape for picture in pictures] == [(height // 2 * 2, width // 2 * 2, 3)] * 3
    assert [picture.mean() for picture in pictures] == pytest.approx(shades, abs=3)  # limited range and quantisation
    assert [file.name for file in tmp_path.iterdir()] == ["video.mp4"]


def test_video_that_cannot_be_written_is_told(tmp_path):
    with pytest.raises(LuxloopError, match=r"video\.mp4: cannot be written \(.*\); name another"):
        VideoWriter(tmp_path / "no" / "video.mp4", 30, (64, 64))
