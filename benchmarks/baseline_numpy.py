"""The control step as one would write it first: NumPy and SciPy, whole textures and frames.

It is given what does not change from step to step: rays, headlight matrix, geometry of the G-buffer, what the lamp cannot see, the
internal model's flat road, its target and gains, and where in the image to look.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, maximum_filter, uniform_filter

from luxloop import ProjectionCommand, Simulation
from luxloop.perception.appearance import error_indices
from luxloop.perception.camera import camera_view
from luxloop.perception.extraction import NEIGHBOURHOOD, WHOLLY_LIT
from luxloop.world.rendering.gbuffer import GBuffer, flat_road, gbuffer
from luxloop.world.rendering.raycast import sees

Floats = NDArray[np.float32]
Lap = Callable[[str], None]


@dataclass(frozen=True)
class Surfaces:
    """A G-buffer of N samples. position, normal: `[3, N]`. albedo: `[N]`, zero in shadow, so that it stays dark."""

    position: Floats
    normal: Floats
    albedo: Floats

    @classmethod
    def of(cls, buffer: GBuffer, seen_by_lamp: NDArray[np.bool_] | bool = True) -> "Surfaces":
        albedo = buffer.albedo.flatten().numpy() * (buffer.object_id.flatten().numpy() >= 0) * seen_by_lamp
        return cls(buffer.position.flatten(1).numpy(), buffer.normal.flatten(1).numpy(), albedo.astype(np.float32))


class Pids(NamedTuple):
    """State `[4]` of four incremental PIDs; previous: None at the start."""

    output: Floats
    integral: Floats | float = 0.0
    previous: Floats | None = None


class Baseline:
    """The same loop as a simulation's: one lamp, u_abs, the raw image, quadrants, a scene that stands still; its state is four PIDs'."""

    def __init__(self, simulation: Simulation) -> None:
        self.camera, self.params = simulation.scenario.camera, simulation.scenario.symbol.extraction
        symbol, world = simulation.symbol, simulation.world
        projector, self.model = symbol.projector, symbol.sensor.model
        (lamp,) = projector.modules
        self.projector, self.headlight = projector, lamp.pixel_controller.headlight
        self.noise = np.random.default_rng(simulation.scenario.seed) if self.camera.noise else None

        self.matrix = self.headlight.matrix.to_scipy()
        weight = self.matrix.T.tocsr()
        self.weight = weight.multiply(1 / weight.sum(axis=1)).tocsr().astype(np.float32)
        self.T_world_lamp = lamp.T_body_headlight.numpy()
        y, z = (axis.numpy() for axis in self.headlight.tangents(projector.symbol.dtype, projector.symbol.device))
        rays = np.stack(np.broadcast_arrays(np.float32(1), y, z[:, None])).reshape(3, -1)
        self.rays = (self.T_world_lamp[:3, :3] @ rays).astype(np.float32)
        self.symbol = projector.symbol.numpy()

        triangles, view = world.scene.at(0.0), camera_view(self.camera).with_rows(self.camera.oversampling)
        surfaces = gbuffer(triangles, view, world.source.face_ids(triangles, view))
        self.surfaces = Surfaces.of(surfaces, sees(triangles, lamp.T_body_headlight[:3, 3], surfaces.position.flatten(1)).numpy())
        self.flat = Surfaces.of(flat_road(view, simulation.scenario.surface.albedo))
        self.base = world.lit(0.0).base.numpy()
        self.limit = self.model.limit.numpy()
        self.target, self.gains = self.model.target.numpy(), self.model.gains.numpy()

        self.bank = symbol.controller.inner.gains
        self.start = Pids(symbol.controller.projection(symbol.start().controller, None).pose.double().numpy())

    def step(self, pids: Pids, lap: Lap) -> tuple[Pids, Floats]:
        """One control step; calls lap with the name of each part when it is done. Returns the next state and the four errors in px."""
        texture = self._light(*pids.output)
        lap("light")
        luminance = self._shade(texture, self.surfaces)
        lap("luminance")
        on, off = self._expose(self.base + luminance), self._expose(self.base)
        lap("camera")
        errors, ratio = self._perceive(on, off, pids.output, texture)
        lap("perceive")
        if self.params.area_low <= ratio <= self.params.area_high:
            pids = self._control(pids, -errors[error_indices()] / self.gains)
        lap("control")
        return pids, errors

    def _control(self, pids: Pids, error: Floats) -> Pids:
        """Limits of output and rate, with back-calculation."""
        names = ("kp", "ki", "kd", "lower", "upper", "rate_limit", "tracking_time")
        kp, ki, kd, lower, upper, rate, time = (getattr(self.bank, name).double().numpy() for name in names)
        derivative = error - (error if pids.previous is None else pids.previous)
        integral = pids.integral + ki * error
        wanted = pids.output + kp * error + integral + kd * derivative
        limited = np.clip(np.clip(wanted, pids.output - rate, pids.output + rate), lower, upper)
        share = np.where(time > 0, np.minimum(1 / time, 1.0), 0.0)
        return Pids(limited, integral + share * (limited - wanted), error)

    def _light(self, x: float, y: float, roll: float, pitch: float) -> Floats:
        """SuperSampling Control with all rays and all pixels, then the light texture `[rows, cols]` in cd."""
        p = self.projector.params
        cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
        forward, left, up = np.array([[cp, sp * sr, sp * cr], [0, cr, -sr], [-sp, cp * sr, cp * cr]]).T.astype(np.float32)
        d1, d2 = -p.width_m * left, -p.length_m * forward
        corner = np.array([x, y, 0], np.float32) - (d1 + d2) / 2
        lamp = self.T_world_lamp[:3, 3].astype(np.float32)
        towards = up @ self.rays
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (up @ (corner - lamp)) / towards
            on_plane = (lamp - corner)[:, None] + distance * self.rays
            u, v = d1 @ on_plane / (d1 @ d1), d2 @ on_plane / (d2 @ d2)
            hit = (distance > 0) & (towards < 0) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
        height, width = self.symbol.shape
        at = np.stack([v[hit] * height - 0.5, u[hit] * width - 0.5])
        setpoint = np.zeros(hit.shape, np.float32)
        setpoint[hit] = p.value * map_coordinates(self.symbol, at, order=1, mode="nearest")
        utilisation = np.clip(self.weight @ np.clip(setpoint, 0, 1), 0, 1)
        return (self.matrix @ utilisation).reshape(self.headlight.rows, self.headlight.cols)

    def _shade(self, texture: Floats, surfaces: Surfaces) -> Floats:
        """Luminance `[height, width]` in cd/m^2 of all camera pixels."""
        h, lamp = self.headlight, self.T_world_lamp.astype(np.float32)
        away = lamp[:3, 3:] - surfaces.position
        x, y, z = -lamp[:3, :3].T @ away
        with np.errstate(divide="ignore", invalid="ignore"):
            row = (h.top - z / x) / (h.top - h.bottom) * h.rows
            col = (h.left - y / x) / (h.left - h.right) * h.cols
            inside = (x > 0) & (row >= 0) & (row <= h.rows) & (col >= 0) & (col <= h.cols)
        d2 = (away[:, inside] ** 2).sum(0)
        cos = np.maximum((surfaces.normal[:, inside] * away[:, inside]).sum(0), 0) / np.sqrt(d2)
        intensity = map_coordinates(texture, np.stack([row[inside] - 0.5, col[inside] - 0.5]), order=1, mode="nearest")
        luminance = np.zeros(inside.shape, np.float32)
        luminance[inside] = surfaces.albedo[inside] * intensity * cos / d2 / np.pi
        return luminance.reshape(self.camera.height_px, self.camera.oversampling, -1).mean(1)

    def _expose(self, luminance: Floats) -> Floats:
        """Digital numbers `[height, width]`."""
        c = self.camera
        electrons = luminance * np.float32(c.exposure_s * c.sensitivity_e_per_cd_s_m2)
        if self.noise is not None:
            electrons += np.sqrt(electrons + np.float32(c.read_noise_e**2)) * self.noise.standard_normal(luminance.shape, np.float32)
        return np.round(np.clip(electrons, 0, c.saturation_e) * np.float32((2**c.bits - 1) / c.saturation_e))

    def _perceive(self, on: Floats, off: Floats, pose: Floats, texture: Floats) -> tuple[Floats, float]:
        """Errors in px, and the ratio of the seen area to that on a flat road."""
        c = self.camera
        electron = np.float32(1 / (c.exposure_s * c.sensitivity_e_per_cd_s_m2))  # in cd/m^2
        level = np.float32(c.saturation_e / (2**c.bits - 1))  # in electrons
        dark = uniform_filter(off, 3, mode="nearest") * level
        variance = np.minimum(dark, c.saturation_e) + (c.read_noise_e**2 * c.noise + level**2 / 12) if c.noise else level**2 / 12
        limit = np.float32(self.params.threshold_sigma * 2**0.5) * np.sqrt(variance) * electron
        projection = ProjectionCommand(self.projector.symbol.new_tensor(pose))
        crop = self.projector.footprint(projection, self.model.eye.view, self.params.footprint_margin_m)
        footprint = np.zeros(on.shape, bool)
        footprint[crop.slices] = True
        symbol = _symbol_image((on - off) * (level * electron), limit) * footprint
        expected = _symbol_image(self._shade(texture, self.flat), self.limit) * footprint
        return _features(symbol) - self.target, float(symbol.sum() / expected.sum())


def _symbol_image(contrast: Floats, limit: Floats) -> Floats:
    """Grey edges, `[height, width]` in 0..1."""
    brightest = maximum_filter(contrast, NEIGHBOURHOOD)
    return np.clip((contrast - limit) / np.maximum(WHOLLY_LIT * brightest - limit, limit / 2), 0, 1)


def _features(symbol: Floats) -> Floats:
    """Centre u and v, roll and pitch of the quadrants, `[4]` in px."""
    height, width = symbol.shape
    u, v = np.arange(width) + 0.5, np.arange(height) + 0.5
    m00 = symbol.sum()
    cu, cv = (symbol * u).sum() / m00, (symbol * v[:, None]).sum() / m00
    rows = []
    for row_share, row_centre in _halves(v, cv):
        row = []
        for column_share, _ in _halves(u, cu):
            part = symbol * row_share[:, None] * column_share
            row.append((part * row_centre[:, None]).sum() / part.sum())
        rows.append(row)
    (tl, tr), (bl, br) = rows
    return np.array([cu, cv, ((tr - tl) + (br - bl)) / 2, ((tr + tl) - (br + bl)) / 2], np.float32)


def _halves(axis: Floats, split: float) -> list[tuple[Floats, Floats]]:
    """Share of each pixel before and after the split, and the centre of that share."""
    before = np.clip(split - axis + 0.5, 0, 1)
    return [(before, axis - (1 - before) / 2), (1 - before, axis + before / 2)]
