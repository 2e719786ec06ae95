"""An open rig: lamp, camera and sensors; it shows light and returns a frame of it."""

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from luxloop.loop.rig import mark
from luxloop.loop.rig.camera import Camera, CameraPicture, opener
from luxloop.loop.rig.ego import Ego, open_ego
from luxloop.loop.rig.keeper import Keeper
from luxloop.loop.rig.light import Light, NoLight, Picture, Shine, open_light
from luxloop.loop.rig.limits import Limited, limited
from luxloop.loop.rig.matching import shows
from luxloop.loop.rig.params import LimitParams, RigParams, refuse_module
from luxloop.loop.rig.rectified import Rectifier, WrongPicture
from luxloop.loop.rig.statistics import Statistics
from luxloop.perception.camera import CameraParams

CAMERA_S = 5.0  # for a camera's first picture
BEAT_S = 0.05  # between two beats at most, half of the least limits.loop_s


@dataclass(frozen=True)
class Taken:
    """A frame, or the reason why it is lost. sent_s, arrived_s: times of the light and of the frame, by `time.monotonic`.

    image: `[height, width]`, None if lost. data: the picture as it arrived.
    """

    sent_s: float
    arrived_s: float
    image: NDArray[np.float32] | None
    reason: str = ""
    data: bytes | NDArray[np.generic] = b""


@dataclass
class Rig:
    """An open rig. armed: whether the lamp is lit; otherwise it is a dry run. light: the device, for tests and messages.

    limits: of the light outside the mark.
    """

    params: RigParams
    armed: bool
    light: Light
    keeper: Keeper
    camera: Camera
    ego: Ego
    rectifier: Rectifier | None
    limits: LimitParams
    statistics: Statistics = field(default_factory=Statistics)
    _stands: tuple[Picture, ...] | None = None
    _changed_s: float = 0.0
    _marked: int = -1  # number of the newest exposure whose mark was seen

    def expose(self, shine: Shine, least_s: float) -> tuple[Limited, Taken]:
        """Show light for at least `least_s`, until a frame of this light alone has arrived or counts as lost."""
        self.statistics.exposures += 1
        began_s = time.monotonic()
        self.statistics.began_s = self.statistics.began_s or began_s
        self.keeper.beat()
        if not self.camera.alive:  # nobody would see it
            self.keeper.dark(self.camera.reason)
            if self.params.triggered:  # without that it would never come back
                self.camera.trigger()
            reason = self.camera.reason
            if (picture := self.camera.next(began_s + self.params.timing.wait_s)) is not None:
                with suppress(WrongPicture):
                    self._image(picture)
            self._done(began_s)
            return Limited(shine), self._lost(shine.number, began_s, reason)
        given = self.limited(shine, began_s)
        self.show(given.shine)
        taken = self._frame(given.shine.number, began_s)
        self._hold(began_s + least_s)
        self._done(began_s)
        return given, taken

    def limited(self, shine: Shine, now_s: float) -> Limited:
        """Light within the limits, given the current light, or the time since the lamp was darkened."""
        dark_s = self.keeper.dark_since_s
        before, changed_s = (self._stands, self._changed_s) if dark_s is None else (None, dark_s)
        given = limited(shine, before, now_s - changed_s, self.limits)
        self.statistics.dimmed += given.dimmed < 1
        self.statistics.slowed += given.slowed < 1
        return given

    def show(self, shine: Shine) -> None:
        """Show light that is within the limits, with the mark."""
        self._stands, self._changed_s = shine.dimmed, time.monotonic()
        marked = shine.pictures if self.params.mark is None else mark.drawn(shine.pictures, self.params.mark, shine.number)
        self.keeper.show(Shine(shine.number, marked, shine.commands))

    def dark(self, reason: str) -> None:
        """Darken the lamp until light is shown again. reason: in words."""
        self.keeper.dark(reason)

    def _hold(self, until_s: float) -> None:
        while (left_s := until_s - time.monotonic()) > 0:
            self.keeper.beat()
            time.sleep(min(left_s, BEAT_S))

    def _done(self, began_s: float) -> None:
        self.statistics.ended_s = time.monotonic()
        self.statistics.hold.add(self.statistics.ended_s - began_s)
        self.keeper.beat()

    def _lost(self, number: int, sent_s: float, reason: str) -> Taken:
        self.statistics.lose(number, reason)
        return Taken(sent_s, np.nan, None, reason)

    def _frame(self, number: int, began_s: float) -> Taken:
        """The first frame of the current light alone, or the reason why there is none."""
        timing, statistics = self.params.timing, self.statistics
        until_s = began_s + timing.wait_s
        last = "no picture came"
        if self.params.triggered and (since_s := self.keeper.since_s) is not None:
            self._hold(since_s + timing.clear_s)
            statistics.seen["old"] += self.camera.forget()
            self.camera.trigger()
        while (now_s := time.monotonic()) < until_s:
            picture = self.camera.next(min(until_s, now_s + BEAT_S))
            self.keeper.beat()
            if (since_s := self.keeper.since_s) is None:
                return self._lost(number, began_s, self.keeper.reason)
            if picture is None:
                continue
            why = self._refused(picture, since_s)
            if why is not None:
                statistics.seen[why] += 1
                last = {"late": "all pictures had lain in a queue"}.get(why, "no picture that shows this light alone came")
                continue
            taken = self._looked_at(picture, number, since_s)
            if isinstance(taken, Taken):
                statistics.seen["taken"] += 1
                return taken
            last = taken
        return self._lost(number, began_s, f"{last} in {timing.wait_s:g} s" if self.camera.alive else self.camera.reason)

    def refuse_misfit(self) -> None:
        """Raises LuxloopError where the camera's next picture cannot become the scenario's image; a triggered camera sends none yet."""
        picture = None if self.params.triggered else self.camera.next(time.monotonic() + self.params.camera.timeout_s)
        if picture is not None and self.rectifier is not None:
            self.rectifier.image(picture.data)

    def _refused(self, picture: CameraPicture, since_s: float) -> str | None:
        """Why a picture may not show only the light sent at since_s: "old", "mixed", or "late" if it lay in a buffer; else None."""
        lag_s = picture.arrived_s - since_s
        if self.params.triggered:  # which has no rhythm
            return None if lag_s > self.params.timing.clear_s else "old"
        verdict = shows(lag_s, self.params.timing, picture.late_s)
        return verdict if verdict != "clear" else None if picture.awaited else "late"

    def _image(self, picture: CameraPicture) -> NDArray[np.float32]:
        """The scenario's image. Raises WrongPicture if the picture does not fit, which darkens the lamp if it goes on."""
        try:
            image = np.zeros((1, 1), np.float32) if self.rectifier is None else self.rectifier.image(picture.data)
        except WrongPicture as error:
            self.camera.judge(str(error))
            raise
        self.camera.judge(None)
        return image

    def _looked_at(self, picture: CameraPicture, number: int, since_s: float) -> Taken | str:
        """The frame of a picture, or the reason why it cannot be used."""
        try:
            image = self._image(picture)
        except WrongPicture as error:
            self.statistics.seen["wrong"] += 1
            return str(error)
        if self.params.mark is not None and self.armed and self.rectifier is not None:
            found = mark.shown(image, self.params.mark)
            if found != number % mark.CODES:
                self.statistics.seen["unmarked" if found is None else "of another exposure"] += 1
                return "no picture with this exposure's mark came" if found is None else "the mark was that of another exposure"
            if self._marked != number:  # the light may have come in its midst; the next picture begins after it has ended
                self._marked = number
                self.statistics.seen["first of its mark"] += 1
                return "no second picture with this exposure's mark came"
        if self.keeper.since_s != since_s:  # while it was looked at
            return self.keeper.reason or "the light changed"
        self.statistics.take(picture.arrived_s - since_s)
        return Taken(since_s, picture.arrived_s, image, data=picture.data)


@contextmanager
def opened(params: RigParams, grids: Sequence[tuple[int, int]], camera: CameraParams | None, *, armed: bool) -> Iterator[Rig]:
    """Open a rig, and darken it at the end in any case.

    grids: rows and columns of the modules' pixels. camera: the scenario's, None if images are not needed. armed: whether the lamp is lit.
    Raises LuxloopError if a device cannot be opened.
    """
    limits = params.limits
    if params.mark is not None:
        refuse_module(params.mark, grids)
        limits = mark.spared(limits, params.mark, grids)
    with ExitStack() as stack:
        rectifier = None if camera is None else Rectifier.of(params, camera)
        ego = open_ego(params.ego)
        stack.callback(ego.close)
        watched = Camera(opener(params.camera), params.camera.timeout_s)
        stack.callback(watched.close)
        light: Light = open_light(params.light, grids) if armed else NoLight()
        keeper = Keeper(light, params.light, params.limits.loop_s, lambda: None if watched.alive else watched.reason)
        stack.callback(keeper.close)
        yield Rig(params, armed, light, keeper, watched, ego, rectifier, limits)


def await_camera(rig: Rig, seconds: float = CAMERA_S) -> bool:
    """Wait for the camera's first pictures, until its period is known; returns whether pictures arrive."""
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        if rig.params.triggered:
            rig.camera.trigger()
            if rig.camera.next(time.monotonic() + rig.params.timing.wait_s) is not None:
                break
            continue
        picture = rig.camera.next(time.monotonic() + 0.05)
        if picture is not None and math.isfinite(picture.late_s):
            break
    return rig.camera.alive
