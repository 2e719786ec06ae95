"""The simulated world lit by a real lamp: the lamp shows each exposure, and its beam on a screen becomes a module's light (T 4.3)."""

import math
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.rig.calibration.files import Calibration
from luxloop.loop.rig.live.beam import Beam
from luxloop.loop.rig.live.digitiser import ONE_FORMAT, Digitiser, luminous
from luxloop.loop.rig.params import RigParams
from luxloop.loop.rig.plant import RigPlant
from luxloop.loop.rig.rectified import AS_SENT, Rectifier, WrongPicture, camera_picture
from luxloop.loop.rig.rig import Rig
from luxloop.loop.rig.wire.poses import BodyPose, PoseSender
from luxloop.loop.simulation.digitised import DigitisedPlant
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame
from luxloop.loop.simulation.simulated import UnderWay
from luxloop.loop.simulation.world import World
from luxloop.perception.camera import CameraParams
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.lamp import REST

DARKS: Final = 8  # frames without light before the run, whose mean is subtracted
FIRST: Final = 40  # number of the run's first exposure on the rig; the numbers below it are for the dark frames, which may be lost


@dataclass(frozen=True, eq=False)
class ScreenPictures(Rectifier):
    """Unchanged pictures of a screen, grey or in colour. shape: height and width in px."""

    shape: tuple[int, int] = (0, 0)

    def image(self, data: bytes | NDArray[np.generic]) -> NDArray[np.float32]:
        """Codes `[height, width]`, or `[height, width, 3]` (blue, green, red), of encoded or raw data.

        Raises WrongPicture if it is damaged or of another size.
        """
        picture = camera_picture(data, cv2.IMREAD_ANYCOLOR | AS_SENT) if isinstance(data, bytes) else data
        if picture.shape[:2] != self.shape:
            (height, width), (rows, columns) = self.shape, picture.shape[:2]
            raise WrongPicture(f"camera: a picture of {columns} x {rows} px, where the calibration is of {width} x {height}")
        return (picture if picture.ndim == 2 else picture[..., :3]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class LivePlant:
    """A plant whose simulated world waits for the lamp at each exposure. If the rig gets no frame of it, the exposure is lost.

    own: the simulated world, and which of its modules is digitised. lab: the rig, which shows this module alone. digitiser: from pictures
    to light textures. beam: the textures. platform: gets the body's poses.
    """

    own: DigitisedPlant
    lab: RigPlant
    digitiser: Digitiser
    beam: Beam
    platform: PoseSender | None = None

    @property
    def truth(self) -> World:
        """The ground truth of the simulated world, lit by the digitised light."""
        return self.own.truth

    def start(self) -> tuple[UnderWay, Arrivals]:
        """The initial state: nothing is lit, and no frame is pending."""
        return self.own.night.start()

    def show(self, state: UnderWay, exposure: Exposure) -> tuple[UnderWay, Arrivals]:
        """Show an exposure on the lamp, digitise its light, and expose a frame of the simulated world in this light."""
        self._move(exposure)
        light = self._light(exposure)
        (frame,) = self.lab.show(None, replace(exposure, number=FIRST + exposure.number, lights=(light,), commands=()))[1].frames
        texture = None if frame.image is None else self._texture(frame, light)
        now = self.beam.take(texture)
        if now is not None:
            self.own.measured.keep(light.u, now)
        queue, arrivals = self.own.night.show(state, exposure)
        if now is None:
            return _changed(queue, arrivals, exposure.number, image=None)
        if frame.shown is not None:
            lights = (*exposure.lights[: self.own.number], *frame.shown.lights, *exposure.lights[self.own.number + 1 :])
            return _changed(queue, arrivals, exposure.number, shown=replace(exposure, lights=lights))
        return queue, arrivals

    def _light(self, exposure: Exposure) -> Utilisation:
        """Utilisations for the lamp, with the module's dimming; the simulated world turns the module."""
        light, command = exposure.lights[self.own.number], exposure.commands[self.own.number] if exposure.commands else REST
        return light if command.intensity == 1 else Utilisation(command.intensity * light.u, light.band)

    def _texture(self, frame: Frame, light: Utilisation) -> Tensor:
        """Light texture `[rows, cols]` in cd of a frame."""
        assert frame.image is not None
        begun_s, since_s, picture = time.monotonic(), self.lab.rig.keeper.since_s, frame.image.cpu().numpy()
        texture = self.digitiser.texture(picture)
        intensity = luminous(texture)
        took_s = time.monotonic() - begun_s
        if since_s is not None:
            self.beam.note(took_s, frame.arrived_s - since_s + took_s, self.digitiser.saturated(picture))
        if bool(light.u.any()):
            self.beam.newest = texture, light.u
        return intensity

    def _move(self, exposure: Exposure) -> None:
        if self.platform is not None:
            body = self.own.night.dynamics.at(exposure.start_s)
            angles = math.degrees(body.roll_rad), math.degrees(body.pitch_rad)
            self.platform.send(BodyPose(exposure.number, exposure.start_s, body.heave_m, *angles))


@contextmanager
def live_plant(rig: Rig, own: DigitisedPlant, calibration: Calibration, camera: CameraParams, exposures: int) -> Iterator[LivePlant]:
    """The plant of an open rig. own: the scenario's plant. calibration: of the rig. camera: the scenario's. exposures: number of exposures.

    Takes dark frames first. Raises LuxloopError if they do not arrive, or if rig, calibration and scenario do not fit together.
    """
    module = own.truth.modules[own.number]
    rig.rectifier = ScreenPictures(rig.params.camera, camera, None, None, (calibration.camera.height, calibration.camera.width))
    lab = RigPlant.of(rig, [module], FIRST + exposures)
    digitiser = Digitiser.of(calibration, module.name, module.headlight)
    dark = torch.zeros(module.headlight.rows, module.headlight.cols)
    with ExitStack() as stack:
        platform = None
        if (to := rig.params.platform) is not None:
            platform = PoseSender(to.host, to.port)
            stack.callback(platform.close)
        yield LivePlant(
            own,
            lab,
            digitiser.without(_dark_frames(lab)),
            Beam(own.late, dark),
            platform,
        )


def refuse_unfit(params: RigParams) -> Path:
    """The calibration's file. Raises LuxloopError if the rig file has no calibration, or has a mark."""
    if params.mark is not None:
        raise LuxloopError("mark: lies in the light that is digitised; take it out, and give light.repeats against lost packets")
    if params.calibration is None:
        raise LuxloopError("calibration: is needed to digitise a beam; name the file of `luxloop rig calibrate` there")
    return params.calibration.file


def _dark_frames(lab: RigPlant) -> NDArray[np.float32]:
    """Pictures of the screen without the lamp's light."""
    dark = Utilisation(torch.zeros(lab.grids[0][0] * lab.grids[0][1]), slice(0, 0))
    found: list[NDArray[np.float32]] = []
    for number in range(FIRST):
        (frame,) = lab.show(None, Exposure(number, 0.0, 0.0, (dark,)))[1].frames
        if frame.image is not None:
            found.append(frame.image.cpu().numpy())
            if found[0].ndim != found[-1].ndim:
                raise LuxloopError(ONE_FORMAT)
        if len(found) == DARKS:
            return np.stack(found)
    raise LuxloopError(f"{len(found)} of {DARKS} dark frames came in {FIRST} tries; measure [timing] with `luxloop rig blink`")


def _changed(queue: UnderWay, arrivals: Arrivals, number: int, **changes: Any) -> tuple[UnderWay, Arrivals]:
    """The queue and the arrivals with changes to the frame of an exposure, whether pending or arrived."""

    def changed(frame: Frame) -> Frame:
        return replace(frame, **changes) if frame.number == number else frame

    return tuple((due, changed(frame)) for due, frame in queue), replace(arrivals, frames=tuple(map(changed, arrivals.frames)))
