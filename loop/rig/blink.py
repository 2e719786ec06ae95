"""The blink test: the lamp blinks at random times; frames give latency, jitter, rolling shutter and drift of the latency."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from luxloop.loop.rig.arrays import Array, Grids, Image, Indices, Mask
from luxloop.loop.rig.camera import CameraPicture
from luxloop.loop.rig.light import Shine
from luxloop.loop.rig.matching import needed_s
from luxloop.loop.rig.rectification import WrongPicture, grey
from luxloop.loop.rig.rig import Rig, await_camera
from luxloop.world.errors import LuxloopError

LEARNT = 2  # first switches, which give the dark and bright levels
HOLD_S = 0.4  # least duration of a light, longer than any camera's latency
SPREAD_S = 0.1  # range of random additional duration, so that blinks meet every phase of the camera
LEARN_S = 1.5  # duration of the first two lights
SEEN = (0.01, 0.1)  # range of the threshold of a visible change, as a share of the full change of a row of pixels
SIGMAS = 5.0  # threshold of a visible change in standard deviations of steady light
LEAST_LEVELS = 3.0  # least change of the brightest part in digital numbers
BRIGHT = 0.5  # pixels that change by this share of the largest change are evaluated
MARGIN = 1.25  # factor on the worst measured jitter
MARGIN_S = 0.008  # additional jitter, for a busy machine
FEWEST = 10  # blinks
DRAWS = 50  # bootstrap samples for the standard deviation of the drift
SURE, DRIFT_MS, LARGE_MS = 3.0, 1.0, 10.0  # a drift is reported above 1 ms/min and three standard deviations, or above 10 ms/min


@dataclass(frozen=True, eq=False)
class BlinkPictures:
    """Pictures of a blink test, n that count and m + 1 in all.

    lag_s: `[n]`, from sending the current light to the picture's arrival. at_s: `[n]`, time of sending this light. late_s: `[n]`, lateness
    against the camera's rhythm, as known on arrival. least, most: `[n]`, smallest and largest share of the change in a row of pixels. seen:
    threshold of a visible change, a share. intervals_s: `[m]`, between all pictures. queued: share of pictures that came from a queue,
    which do not count.
    """

    lag_s: Array
    at_s: Array
    late_s: Array
    least: Array
    most: Array
    seen: float
    intervals_s: Array
    queued: float


@dataclass(frozen=True)
class BlinkResult:
    """Result of a blink test; times in s.

    latency_s, jitter_s, rolling_s: keys of `[timing]`, of rows that see the light. first_s: median, 95 % quantile and largest time from
    light to the first frame of this light alone. drift_s_per_min: drift of the latency, and its standard deviation. interval_s: median and
    largest time between pictures. queued: share of pictures that came from a queue.
    """

    latency_s: float
    jitter_s: float
    rolling_s: float
    first_s: tuple[float, float, float]
    drift_s_per_min: tuple[float, float]
    interval_s: tuple[float, float]
    queued: float
    blinks: int

    @property
    def timing(self) -> dict[str, float]:
        """Keys of `[timing]`."""
        return {name: round(getattr(self, name), 4) for name in ("latency_s", "jitter_s", "rolling_s")}

    @property
    def warning(self) -> str:
        """Warning of a drift that makes the timing invalid; empty without."""
        drift_ms, std_ms = (1e3 * each for each in self.drift_s_per_min)
        if abs(drift_ms) <= min(max(SURE * std_ms, DRIFT_MS), LARGE_MS):
            return ""
        return (
            f"the latency changed by {drift_ms:+.1f} ± {std_ms:.1f} ms a minute, so this timing will not hold: end what else loads the "
            "machines, look for a queue between camera and loop, and measure again with more --blinks"
        )


def record(rig: Rig, grids: Grids, blinks: int, level: float, advance: Callable[[], None] = lambda: None) -> BlinkPictures:
    """Pictures of an armed rig's blinking lamp.

    level: utilisation of all pixels, reduced to the limits. advance: called after each blink. Raises LuxloopError if the camera does not
    see the lamp, or fails.
    """
    if blinks < FEWEST:
        raise LuxloopError(f"--blinks {blinks}: is too few for a worst case; give {FEWEST} at least")
    lit, black = (tuple(np.full(grid, u, np.float32) for grid in grids) for u in (min(level, rig.limits.share), 0.0))
    drawn = np.random.default_rng(0)
    switches, pictures = list[tuple[float, bool]](), list[tuple[float, float, Image]]()
    settled: list[Image] = []
    queued = void = 0
    arrivals: list[float] = []
    region: tuple[Image, Mask] | None = None
    was_lit = False
    for number in range(LEARNT + blinks):
        on = number % 2 == 1
        if rig.camera.alive:
            _show(rig, Shine(number, lit if on else black))
        else:
            rig.keeper.dark(rig.camera.reason)
        sent_s = rig.keeper.since_s
        hold_s = LEARN_S if number < LEARNT else HOLD_S + SPREAD_S * drawn.random()
        kept, begun = [], len(pictures)
        in_doubt = sent_s is None
        if sent_s is not None:
            switches.append((sent_s, on))
            for picture, image in _pictures(rig, sent_s + hold_s):
                arrivals.append(picture.arrived_s)
                queued += not picture.awaited
                if region is None:
                    kept.append(image)
                elif picture.awaited and picture.arrived_s > sent_s:  # not of the previous blink, which may be void
                    pictures.append((picture.arrived_s, picture.late_s, (image * region[0]).sum(1)[region[1]]))
            in_doubt = rig.keeper.since_s != sent_s or not rig.camera.alive
        if in_doubt and (number < LEARNT or (void := void + 1) > blinks / 2):
            raise LuxloopError(f"blink: {rig.keeper.reason or rig.camera.reason}")
        if sent_s is None:
            await_camera(rig)
        if in_doubt or not (on or was_lit):  # black after darkness is no change of light
            del pictures[begun:]
        was_lit = on and not in_doubt
        if number < LEARNT:
            settled.append(_steady(kept))
            if number == LEARNT - 1:
                region = _region(*(each.mean(0) for each in settled))
        advance()
    assert region is not None
    mask, rows = region
    steady = [(each * mask).sum(2)[:, rows] for each in settled]
    rig.keeper.dark("the blink test has ended")
    return _blink_pictures(switches, pictures, steady, (np.diff(np.array(arrivals)), queued / max(len(arrivals), 1)))


def evaluate(pictures: BlinkPictures, blinks: int) -> BlinkResult:
    """Timing from the pictures of a blink test. Raises LuxloopError if they are too few."""
    whole, begun, lag_s = pictures.least > 1 - pictures.seen, pictures.most > pictures.seen, pictures.lag_s
    if whole.sum() < blinks / 2 or len(lag_s) < 2 * blinks:
        raise LuxloopError("blink: too few pictures came, or the light is not steady; check the camera's rate, its exposure, and the lamp")
    interval_s = float(np.median(pictures.intervals_s))
    latency_s, begins_s = (_between(lag_s, each, interval_s / 2) for each in (whole, begun))
    first = np.array([lag_s[(pictures.at_s == at_s) & whole].min() for at_s in np.unique(pictures.at_s[whole])])
    starts_s, drawn = np.unique(pictures.at_s), np.random.default_rng(0)
    blinks_of = [np.flatnonzero(pictures.at_s == at_s) for at_s in starts_s]
    halves = blinks_of[: len(blinks_of) // 2], blinks_of[len(blinks_of) // 2 :]

    def latency(parts: Sequence[Indices]) -> float:
        at = np.concatenate(parts)
        return _between(lag_s[at], whole[at], interval_s / 2)

    minutes = (starts_s[len(halves[0]) :].mean() - starts_s[: len(halves[0])].mean()) / 60
    early, later = map(latency, halves)
    others = [[latency([half[k] for k in drawn.integers(len(half), size=len(half))]) for half in halves] for _ in range(DRAWS)]
    return BlinkResult(
        latency_s,
        MARGIN * needed_s(lag_s[~whole] - latency_s, pictures.late_s[~whole]) + MARGIN_S,
        max(latency_s - begins_s, 0.0),
        (float(np.median(first)), float(np.quantile(first, 0.95)), float(first.max())),
        ((later - early) / minutes, float(np.diff(others).std()) / minutes),
        (interval_s, float(pictures.intervals_s.max())),
        pictures.queued,
        blinks,
    )


def _show(rig: Rig, shine: Shine) -> None:
    """Show light at once. Raises LuxloopError if the rate limit forbids that."""
    rig.keeper.beat()
    limited_light = rig.limit(shine, time.monotonic())
    if limited_light.slowed < 1:
        raise LuxloopError("limits.change_per_s: is too low for a blink; give a lower --level, or raise it")
    rig.show(limited_light.shine)


def _pictures(rig: Rig, until_s: float) -> Iterator[tuple[CameraPicture, Image]]:
    """Pictures with their grey images until a time, as long as the camera works."""
    while time.monotonic() < until_s:
        rig.keeper.beat()
        if not rig.camera.alive:
            return  # the watchdog darkens the lamp
        picture = rig.camera.next(min(until_s, time.monotonic() + 0.1))
        if picture is not None:
            try:
                yield picture, grey(picture.data).astype(np.float32)
            except WrongPicture:
                continue


def _steady(images: list[Image]) -> Image:
    """The last half of the images `[n, height, width]`, 20 at most. Raises LuxloopError if these are too few, or differ in size."""
    last = images[len(images) // 2 :][-20:]
    if len(last) < 3 or len({each.shape for each in last}) > 1:
        raise LuxloopError("blink: too few pictures came, or of different sizes; see `luxloop rig check`")
    return np.stack(last)


def _region(dark: Image, bright: Image) -> tuple[Image, Mask]:
    """Mask of the pixels that show the light, and of the rows with such pixels. Raises LuxloopError if there are none."""
    change = bright - dark
    most = float(np.quantile(change, 0.999))
    if most < LEAST_LEVELS:
        raise LuxloopError(
            f"blink: the camera does not see the lamp ({most:.1f} digital numbers brighter); aim it, or give a higher --level"
        )
    mask = (change > BRIGHT * most).astype(np.float32)
    counts = mask.sum(1)
    return mask, counts > 0.2 * counts.max()


def _blink_pictures(
    switches: Sequence[tuple[float, bool]],
    pictures: Sequence[tuple[float, float, Image]],
    steady: Sequence[Image],
    came: tuple[Array, float],
) -> BlinkPictures:
    """Evaluated pictures.

    steady: dark and bright rows of pixels, `[n, rows]` each. came: intervals between pictures, and the queued share.
    """
    dark, bright = (np.median(each, axis=0) for each in steady)
    scatter = max(float((each.std(0) / (bright - dark)).max()) for each in steady)
    seen = min(max(SIGMAS * scatter, SEEN[0]), SEEN[1])
    starts_s = np.array([at_s for at_s, _ in switches])
    values = []
    for arrived_s, late_s, rows in pictures:
        k = int(np.searchsorted(starts_s, arrived_s, "right")) - 1
        if k < LEARNT:
            continue
        at_s, on = switches[k]
        share = (rows - dark) / (bright - dark)
        share = share if on else 1 - share
        values.append((arrived_s - at_s, at_s, late_s, share.min(), share.max()))
    columns = np.array(values).reshape(-1, 5).T
    return BlinkPictures(columns[0], columns[1], columns[2], columns[3], columns[4], seen, *came)


def _between(lag_s: Array, after: Mask, reach_s: float) -> float:
    """Mean transition time of `after`, from pictures within `reach_s` of the time that separates them best."""
    order = np.argsort(lag_s)
    lags, late = lag_s[order], after[order]
    wrong = np.concatenate([[0], np.cumsum(late)]) + np.concatenate([np.cumsum(~late[::-1])[::-1], [0]])  # with a border before each
    best = np.flatnonzero(wrong == wrong.min())
    low, high = best[0], best[-1]
    border = (lags[max(low - 1, 0)] + lags[min(high, len(lags) - 1)]) / 2
    near = np.abs(lags - border) < reach_s
    if not near.any():
        return float(border)
    ends = np.concatenate([[border - reach_s], (lags[near][1:] + lags[near][:-1]) / 2, [border + reach_s]])
    return float(border + reach_s - (np.diff(ends) * late[near]).sum())  # of the time within reach, the part in which they are after
