"""Earlier ways to control a matrix headlight, by name, to be compared with (T 3.4, 3.5, 8.5)."""

from collections.abc import Mapping
from types import MappingProxyType

import torch
from torch import Tensor

from controllers.pixels.mrpc_params import MrpcParams
from world.errors import LuxloopError
from world.headlight import Headlight
from world.spmv import row_of_entries

EMULATIONS: Mapping[str, MrpcParams] = MappingProxyType(
    {
        "bounding_rectangle": MrpcParams(shape="rectangle", mapping="direct", a_x=0.5),  # pixels of one brightness, no overlap
        "rendering": MrpcParams(sampling="brightest"),  # the lamp as a camera: one ray a pixel, no anti-aliasing
        "centroid": MrpcParams(sampling="centroid"),  # a pixel is a point
        "maximal_influence": MrpcParams(mapping="maximal"),  # the strongest pixel of a direction is asked for all of it
        "supersampling_uniform": MrpcParams(sampling="uniform"),
        "supersampling_rotated": MrpcParams(sampling="rotated"),
        "supersampling_n_rooks": MrpcParams(sampling="n_rooks"),
        "supersampling_quincunx": MrpcParams(sampling="quincunx"),
    }
)


def angle_intensity_bend(beam: Tensor, headlight: Headlight, yaw: float) -> Tensor:
    """A beam `[..., n_p]` bent to the left by rad: each row's utilisation as a function of its pixels' horizontal angles, moved (T 3.4).

    Between centroids it is interpolated; beyond the outermost there is no light. Pixels that give no light are left out.
    Raises LuxloopError for a lamp of one column.
    """
    angle = _centroid_angles(headlight).to(beam)
    bent = torch.zeros_like(beam)
    for pixels in torch.arange(headlight.n_pixels, device=beam.device).view(headlight.pixel_rows, headlight.pixel_cols):
        pixels = pixels[angle[pixels].isfinite()]
        if len(pixels) < 2:
            continue
        pixels = pixels[angle[pixels].argsort()]
        known, wanted = angle[pixels].contiguous(), angle[pixels] - yaw
        after = torch.searchsorted(known, wanted).clamp(1, len(known) - 1)
        part = (wanted - known[after - 1]) / (known[after] - known[after - 1])
        inside = (wanted >= known[0]) & (wanted <= known[-1])
        bent[..., pixels] = torch.where(inside, torch.lerp(beam[..., pixels[after - 1]], beam[..., pixels[after]], part), 0.0)
    return bent


def matrix_shift_bend(beam: Tensor, headlight: Headlight, yaw: float) -> Tensor:
    """A beam `[..., n_p]` bent to the left by rad: its utilisations as an image, moved by whole and part columns (T 3.4).

    Raises LuxloopError for a lamp of one column.
    """
    angle = _centroid_angles(headlight).view(headlight.pixel_rows, headlight.pixel_cols)
    pitch = -(angle[:, 1:] - angle[:, :-1]).nanmean()
    shift = float(yaw / pitch)  # columns to the left
    image = beam.unflatten(-1, (headlight.pixel_rows, headlight.pixel_cols))
    columns = torch.arange(headlight.pixel_cols, dtype=torch.float64, device=beam.device) + shift
    first = columns.floor()
    part = (columns - first).to(beam)

    def column(at: Tensor) -> Tensor:
        inside = (at >= 0) & (at < headlight.pixel_cols)
        return image[..., at.clamp(0, headlight.pixel_cols - 1).long()] * inside

    return torch.lerp(column(first), column(first + 1), part).flatten(-2)


def _centroid_angles(headlight: Headlight) -> Tensor:
    """Horizontal angle of every pixel's centroid `[n_p]` in rad, to the left positive; NaN where a pixel gives no light.

    Raises LuxloopError for a lamp of one column.
    """
    if headlight.pixel_cols < 2:
        raise LuxloopError(f"{headlight.name!r} has one column of pixels and bends no beam: take a lamp of two columns or more")
    entries = headlight.matrix.transposed
    pixel, light = row_of_entries(entries), entries.values.double()
    y, _ = headlight.tangents(torch.float64, light.device)
    zero = torch.zeros(headlight.n_pixels, dtype=torch.float64, device=light.device)
    moment = zero.index_add(0, pixel, light * y[entries.indices.long() % headlight.cols])
    return (moment / zero.index_add(0, pixel, light)).atan()
