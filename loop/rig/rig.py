"""An open rig: lamp, camera and sensors; it shows light, returns a frame of it, and keeps statistics."""

import math
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from luxloop.loop.rig.arrays import Data, Grids, Image
from luxloop.loop.rig.camera import Camera, CameraPicture
from luxloop.loop.rig.cameras import opener
from luxloop.loop.rig.ego import Ego, open_ego
from luxloop.loop.rig.keeper import Keeper
from luxloop.loop.rig.light import LightDevice, LimitedLight, Picture, Shine, limit
from luxloop.loop.rig.lights import open_light
from luxloop.loop.rig.matching import CODES, draw_mark, limits_beside_mark, read_mark, shows
from luxloop.loop.rig.params import LimitParams, RigParams
from luxloop.loop.rig.rectification import Rectify, WrongPicture, grey, rectifier
from luxloop.perception.camera import CameraParams
from luxloop.world.errors import LuxloopError

MOST_LOSSES = 1000  # lost frames with the number of their exposure in the summary
LEAST_FRAMES = 0.8  # share of exposures with a frame; jitter, lost packets and a reconnecting camera cost less
LONGEST_SILENCE = 10  # exposures without a frame at the end of a run whose rig has failed


BIN_S = 0.0005
BINS = 10_000  # up to 5 s; later times count as the last bin


@dataclass
class TimeHistogram:
    """Histogram of times, of constant memory in runs of days."""

    counts: Image = field(default_factory=lambda: np.zeros(BINS, np.int64))
    worst_s: float = 0.0

    def add(self, time_s: float) -> None:
        self.counts[min(max(int(time_s / BIN_S), 0), BINS - 1)] += 1
        self.worst_s = max(self.worst_s, time_s)

    def quantile_s(self, share: float) -> float | None:
        """Quantile in s, None without times. share: 0..1."""
        if not self.counts.any():
            return None
        at = int(np.searchsorted(np.cumsum(self.counts), share * self.counts.sum()))
        return min((at + 0.5) * BIN_S, self.worst_s)

    @property
    def in_ms(self) -> dict[str, float | None]:
        """Median, 95 % quantile and largest in ms; None without times."""
        values = {"median": self.quantile_s(0.5), "p95": self.quantile_s(0.95), "worst": self.worst_s if self.counts.any() else None}
        return {name: None if value is None else round(1e3 * value, 2) for name, value in values.items()}


@dataclass
class Statistics:
    """Statistics of a run so far.

    lateness: times from sending light to the arrival of its frame. hold: durations of exposures. seen: number of pictures by their use.
    silent: exposures since the newest frame.
    """

    lateness: TimeHistogram = field(default_factory=TimeHistogram)
    hold: TimeHistogram = field(default_factory=TimeHistogram)
    seen: Counter[str] = field(default_factory=Counter)
    lost: Counter[str] = field(default_factory=Counter)
    losses: list[tuple[int, str]] = field(default_factory=list)
    exposures: int = 0
    silent: int = 0
    dimmed: int = 0
    slowed: int = 0
    began_s: float = 0.0
    ended_s: float = 0.0

    def lose(self, number: int, reason: str) -> None:
        self.lost[reason] += 1
        self.silent += 1
        if len(self.losses) < MOST_LOSSES:
            self.losses.append((number, reason))

    @property
    def failure(self) -> str:
        """Reason why the rig has failed: fewer than 80 % of the exposures have a frame, or none of the last ten; empty for a working
        rig.
        """
        came = self.exposures - self.lost.total()
        if came >= LEAST_FRAMES * self.exposures and self.silent < LONGEST_SILENCE:
            return ""
        silence = f", none of the last {self.silent}" if self.silent else ""
        why = f" ({self.lost.most_common(1)[0][0]})" if self.lost else ""
        return f"frames of only {came} of {self.exposures} exposures came{silence}{why}; see `luxloop rig check` and `luxloop rig blink`"

    def summary(self, per_step: int) -> dict[str, Any]:
        """The statistics as plain data. per_step: exposures per control step."""
        lasted_s = self.ended_s - self.began_s
        return {
            **{name: getattr(self, name) for name in ("exposures", "silent", "dimmed", "slowed")},
            "lost": dict(self.lost),
            "losses": [{"exposure": number, "reason": reason} for number, reason in self.losses],
            "control_rate_hz": round(self.exposures / per_step / lasted_s, 3) if lasted_s > 0 else None,
            "light_to_frame_ms": self.lateness.in_ms,
            "hold_ms": self.hold.in_ms,
            "pictures": dict(self.seen),
        }


CAMERA_S = 5.0  # time-out of a camera's first picture
BEAT_S = 0.05  # longest time between two beats, half of the least limits.loop_s


@dataclass(frozen=True)
class RigFrame:
    """A frame, or the reason why it is lost.

    sent_s, arrived_s: times of the light and of the frame, by `time.monotonic`. image: `[height, width]`, None if lost. data: the picture
    as it arrived.
    """

    sent_s: float
    arrived_s: float
    image: Image | None
    reason: str = ""
    data: Data = b""


@dataclass
class Rig:
    """An open rig.

    armed: whether the lamp is lit; otherwise it is a dry run. light: the device, for tests and messages. limits: of the light outside the
    mark.
    """

    params: RigParams
    armed: bool
    light: LightDevice
    keeper: Keeper
    camera: Camera
    ego: Ego
    rectify: Rectify | None
    limits: LimitParams
    statistics: Statistics = field(default_factory=Statistics)
    _stands: tuple[Picture, ...] | None = None
    _changed_s: float = 0.0
    _marked: int = -1  # number of the newest exposure whose mark was seen

    def expose(self, shine: Shine, least_s: float) -> tuple[LimitedLight, RigFrame]:
        """Show light for at least `least_s`, until a frame of this light alone has arrived or counts as lost."""
        self.statistics.exposures += 1
        began_s = time.monotonic()
        self.statistics.began_s = self.statistics.began_s or began_s
        self.keeper.beat()
        if not self.camera.alive:  # no frame would come
            self.keeper.dark(reason := self.camera.reason)
            if (picture := self.picture(began_s + self.params.timing.wait_s)) is not None:
                with suppress(WrongPicture):
                    self._image(picture)
            self._done(began_s)
            return LimitedLight(shine), self._lost(shine.number, began_s, reason)
        limited_light = self.limit(shine, began_s)
        self.show(limited_light.shine)
        frame = self._frame(limited_light.shine.number, began_s)
        self._wait_until(began_s + least_s)
        self._done(began_s)
        return limited_light, frame

    def limit(self, shine: Shine, now_s: float) -> LimitedLight:
        """Light within the limits, given the current light or the time since the lamp was darkened."""
        dark_s = self.keeper.dark_since_s
        before, changed_s = (self._stands, self._changed_s) if dark_s is None else (None, dark_s)
        limited_light = limit(shine, before, now_s - changed_s, self.limits)
        self.statistics.dimmed += limited_light.dimmed < 1
        self.statistics.slowed += limited_light.slowed < 1
        return limited_light

    def show(self, shine: Shine) -> None:
        """Show light that is within the limits, together with the mark."""
        self._stands, self._changed_s = shine.net_pictures, time.monotonic()
        marked = shine.pictures if self.params.mark is None else draw_mark(shine.pictures, self.params.mark, shine.number)
        self.keeper.show(Shine(shine.number, marked, shine.commands))

    def picture(self, until_s: float) -> CameraPicture | None:
        """The camera's next picture, triggered if required; None if none arrives until until_s."""
        if self.params.has_trigger:
            self.camera.trigger()
        return self.camera.next(until_s)

    def _wait_until(self, until_s: float) -> None:
        while (left_s := until_s - time.monotonic()) > 0:
            self.keeper.beat()
            time.sleep(min(left_s, BEAT_S))

    def _done(self, began_s: float) -> None:
        self.statistics.ended_s = time.monotonic()
        self.statistics.hold.add(self.statistics.ended_s - began_s)
        self.keeper.beat()

    def _lost(self, number: int, sent_s: float, reason: str) -> RigFrame:
        self.statistics.lose(number, reason)
        return RigFrame(sent_s, np.nan, None, reason)

    def _frame(self, number: int, began_s: float) -> RigFrame:
        """The first frame of the current light alone, or the reason why there is none."""
        timing, statistics = self.params.timing, self.statistics
        until_s = began_s + timing.wait_s
        last = "no picture came"
        if self.params.has_trigger and (since_s := self.keeper.since_s) is not None:
            self._wait_until(since_s + timing.clear_s)
            statistics.seen["old"] += self.camera.forget()
            self.camera.trigger()
        while (now_s := time.monotonic()) < until_s:
            picture = self.camera.next(min(until_s, now_s + BEAT_S))
            self.keeper.beat()
            if (since_s := self.keeper.since_s) is None:
                return self._lost(number, began_s, self.keeper.reason)
            if picture is None:
                continue
            why = self._rejection(picture, since_s)
            if why is not None:
                statistics.seen[why] += 1
                last = {"late": "all pictures had lain in a queue"}.get(why, "no picture that shows this light alone came")
                continue
            frame = self._frame_of(picture, number, since_s)
            if isinstance(frame, RigFrame):
                statistics.seen["taken"] += 1
                return frame
            last = frame
        return self._lost(number, began_s, f"{last} in {timing.wait_s:g} s" if self.camera.alive else self.camera.reason)

    def refuse_misfit(self) -> None:
        """Raise LuxloopError if the camera's next picture cannot become the scenario's image; a triggered camera sends none yet."""
        picture = None if self.params.has_trigger else self.camera.next(time.monotonic() + self.params.camera.timeout_s)
        if picture is not None and self.rectify is not None:
            self.rectify(picture.data)

    def _rejection(self, picture: CameraPicture, since_s: float) -> str | None:
        """Reason why a picture may show other light than that sent at since_s: "old", "mixed", or "late" if it was in a buffer; else
        None.
        """
        lag_s = picture.arrived_s - since_s
        if self.params.has_trigger:  # a triggered camera has no rhythm
            return None if lag_s > self.params.timing.clear_s else "old"
        content = shows(lag_s, self.params.timing, picture.late_s)
        return content if content != "clear" else None if picture.awaited else "late"

    def _image(self, picture: CameraPicture) -> Image:
        """The scenario's image. Raises WrongPicture if the picture does not fit, which darkens the lamp if it persists."""
        try:
            image = np.zeros((1, 1), np.float32) if self.rectify is None else self.rectify(picture.data)
        except WrongPicture as error:
            self.camera.note_misfit(str(error))
            raise
        self.camera.note_misfit(None)
        return image

    def _frame_of(self, picture: CameraPicture, number: int, since_s: float) -> RigFrame | str:
        """Frame of a picture, or the reason why the picture cannot be used."""
        try:
            image = self._image(picture)
        except WrongPicture as error:
            self.statistics.seen["wrong"] += 1
            return str(error)
        if self.params.mark is not None and self.armed and self.rectify is not None:
            found = read_mark(image, self.params.mark)
            if found != number % CODES:
                self.statistics.seen["unmarked" if found is None else "of another exposure"] += 1
                return "no picture with this exposure's mark came" if found is None else "the mark was that of another exposure"
            if self._marked != number:  # the light may have changed during this picture
                self._marked = number
                self.statistics.seen["first of its mark"] += 1
                return "no second picture with this exposure's mark came"
        if self.keeper.since_s != since_s:  # the light was interrupted meanwhile
            return self.keeper.reason or "the light changed"
        self.statistics.lateness.add(picture.arrived_s - since_s)
        self.statistics.silent = 0
        return RigFrame(since_s, picture.arrived_s, image, data=picture.data)


@contextmanager
def open_rig(params: RigParams, grids: Grids, camera: CameraParams | None, *, armed: bool) -> Iterator[Rig]:
    """Open a rig, and darken it at the end in any case.

    grids: rows and columns of the modules' pixels. camera: the scenario's, None if images are not needed. armed: whether to light the lamp.
    Raises LuxloopError if a device cannot be opened.
    """
    limits = params.limits
    if params.mark is not None:
        limits = limits_beside_mark(limits, params.mark, grids)
    with ExitStack() as stack:
        rectify = None if camera is None else rectifier(params, camera)
        ego = open_ego(params.ego)
        stack.callback(ego.close)
        watched = Camera(opener(params.camera), params.camera.timeout_s)
        stack.callback(watched.close)
        light = open_light(params.light, grids) if armed else LightDevice()
        keeper = Keeper(light, params.light, params.limits.loop_s, lambda: None if watched.alive else watched.reason)
        stack.callback(keeper.close)
        yield Rig(params, armed, light, keeper, watched, ego, rectify, limits)


def await_camera(rig: Rig, seconds: float = CAMERA_S) -> bool:
    """Wait for the camera's first pictures until its period is known; returns whether pictures arrive."""
    until_s, triggered = time.monotonic() + seconds, rig.params.has_trigger
    while time.monotonic() < until_s:
        picture = rig.picture(time.monotonic() + (rig.params.timing.wait_s if triggered else 0.05))
        if picture is not None and (triggered or math.isfinite(picture.late_s)):
            break
    return rig.camera.alive


LOOK_S = 3.0


def look(rig: Rig, seconds: float = LOOK_S) -> dict[str, Any]:
    """Rate, sizes and brightness of the camera's pictures during a time. Raises LuxloopError if fewer than two arrive."""
    if not await_camera(rig):
        raise LuxloopError(rig.camera.reason)
    rig.camera.forget()
    arrivals, late, sizes, brightest, refused = [], 0, set[tuple[int, int]](), 0.0, Counter[str]()
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        if (picture := rig.picture(until_s)) is None:
            break
        arrivals.append(picture.arrived_s)
        late += not picture.awaited
        try:
            image = grey(picture.data)
            sizes.add((image.shape[1], image.shape[0]))
            brightest = max(brightest, float(image.max()) / (2 ** (rig.params.camera.bits or 8 * image.dtype.itemsize) - 1))
            if rig.rectify is not None:
                rig.rectify(picture.data)
        except WrongPicture as error:
            refused[str(error)] += 1
    if len(arrivals) < 2:
        raise LuxloopError(f"camera: {len(arrivals)} pictures in {seconds:g} s; it is too slow, or has stopped")
    intervals = np.diff(arrivals)
    return {
        "sizes": sorted(sizes),
        "rate_hz": (len(arrivals) - 1) / (arrivals[-1] - arrivals[0]),
        "interval_worst_ms": 1e3 * float(intervals.max()),
        "late": late / len(arrivals),
        "brightest": brightest,
        "refused": refused.most_common(1)[0][0] if 2 * refused.total() > len(arrivals) else "",
    }
