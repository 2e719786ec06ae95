"""The blink test: the lamp goes on and off at random times, and frames tell when that is seen (latency, jitter, rolling shutter, drift)."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from luxloop.loop.rig.arrays import Array, Grids, Image, Indices, Mask
from luxloop.loop.rig.camera import CameraPicture
from luxloop.loop.rig.light import Shine
from luxloop.loop.rig.matching import needed_s
from luxloop.loop.rig.rectification import WrongPicture, grey
from luxloop.loop.rig.rig import Rig, await_camera
from luxloop.world.errors import LuxloopError

LEARNT: Final = 2  # switches from which the levels are learnt
HOLD_S: Final = 0.4  # of a light at least, longer than any camera's latency
SPREAD_S: Final = 0.1  # by which holds differ, so that blinks meet every phase of the camera
LEARN_S: Final = 1.5  # of the first light and the first darkness, from whose end the levels are taken
SEEN: Final = (0.01, 0.1)  # share of the change in a row of pixels that counts as seen, and whose lack as not yet whole: least and most
SIGMAS: Final = 5.0  # of the scatter of steady light, which is not taken for a change
LEAST_LEVELS: Final = 3.0  # digital numbers by which the brightest part has to change
BRIGHT: Final = 0.5  # share of the largest change: pixels with more are looked at
MARGIN: Final = 1.25  # on the worst that was measured, since worse will come
MARGIN_S: Final = 0.008  # light may come later than in these few blinks, if a machine on its way is busy
FEWEST: Final = 10  # blinks
DRAWS: Final = 50  # of the blinks, for the scatter of the drift
SURE, DRIFT_MS, LARGE_MS = 3.0, 1.0, 10.0  # a drift is told from 1 ms a minute and three standard deviations on, or from 10 ms a minute on


@dataclass(frozen=True, eq=False)
class BlinkPictures:
    """Pictures of a blink test. lag_s: `[n]`, from sending the light that stands to the picture's arrival. at_s: `[n]`, when that was sent.
    late_s: `[n]`, by how much they came later than the camera's rhythm lets expect, as was known when they came. least, most: `[n]`, share
    of the change that is seen in the row of pixels that shows least and most of it. seen: share that is more than scatter. intervals_s:
    `[m]`, between all pictures that came. queued: share of those that lay in a queue, which are left out of the others.
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
    """What a blink test found; times in s.

    latency_s, jitter_s, rolling_s: keys of `[timing]`, of the rows that see the light. first_s: median, 95 % and worst time from light to
    the first frame that shows nothing else. drift_s_per_min: by how much the latency grows, and its standard deviation. interval_s: median
    and worst time between pictures. queued: share of the pictures that lay in a queue.
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
        """Why the timing may not hold, empty if nothing speaks against it."""
        drift_ms, std_ms = (1e3 * each for each in self.drift_s_per_min)
        if abs(drift_ms) <= min(max(SURE * std_ms, DRIFT_MS), LARGE_MS):
            return ""
        return (
            f"the latency changed by {drift_ms:+.1f} ± {std_ms:.1f} ms a minute, so this timing will not hold: end what else loads the "
            "machines, look for a queue between camera and loop, and measure again with more --blinks"
        )


def record(rig: Rig, grids: Grids, blinks: int, level: float, advance: Callable[[], None] = lambda: None) -> BlinkPictures:
    """Pictures of an armed rig's lamp that blinks. level: utilisation of all pixels, where the limits allow it. advance: called after each
    blink.

    Raises LuxloopError where the camera does not see it.
    """
    if blinks < FEWEST:
        raise LuxloopError(f"--blinks {blinks}: is too few for a worst case; give {FEWEST} at least")
    lit, black = (tuple(np.full(grid, u, np.float32) for grid in grids) for u in (min(level, rig.limits.share), 0.0))
    drawn = np.random.default_rng(0)
    switches, pictures = list[tuple[float, bool]](), list[tuple[float, float, Image]]()
    settled: list[Image] = []
    queued = void = 0
    arrivals: list[float] = []
    rows: Mask | None = None
    mask: Image | None = None
    was_lit = False
    for number in range(LEARNT + blinks):
        on = number % 2 == 1
        if rig.camera.alive:
            _show(rig, Shine(number, lit if on else black))
        else:
            rig.dark(rig.camera.reason)
        sent_s = rig.keeper.since_s
        hold_s = LEARN_S if number < LEARNT else HOLD_S + SPREAD_S * drawn.random()
        kept, begun = [], len(pictures)
        in_doubt = sent_s is None
        if sent_s is not None:
            switches.append((sent_s, on))
            for picture, image in _pictures(rig, sent_s + hold_s):
                arrivals.append(picture.arrived_s)
                queued += not picture.awaited
                if mask is None:
                    kept.append(image)
                elif picture.awaited and picture.arrived_s > sent_s:  # none of the blink before, which may be void
                    assert rows is not None
                    pictures.append((picture.arrived_s, picture.late_s, (image * mask).sum(1)[rows]))
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
                mask, rows = _region(*(each.mean(0) for each in settled))
        advance()
    assert mask is not None and rows is not None
    steady = [(each * mask).sum(2)[:, rows] for each in settled]
    rig.dark("the blink test has ended")
    return _blink_pictures(switches, pictures, steady, (np.diff(np.array(arrivals)), queued / max(len(arrivals), 1)))


def evaluate(looks: BlinkPictures, blinks: int) -> BlinkResult:
    """What the pictures of a blink test tell. Raises LuxloopError where they are too few."""
    whole, begun, lag_s = looks.least > 1 - looks.seen, looks.most > looks.seen, looks.lag_s
    if whole.sum() < blinks / 2 or len(lag_s) < 2 * blinks:
        raise LuxloopError("blink: too few pictures came, or the light is not steady; check the camera's rate, its exposure, and the lamp")
    interval_s = float(np.median(looks.intervals_s))
    latency_s, begins_s = (_between(lag_s, each, interval_s / 2) for each in (whole, begun))
    first = np.array([lag_s[(looks.at_s == at_s) & whole].min() for at_s in np.unique(looks.at_s[whole])])
    starts_s, drawn = np.unique(looks.at_s), np.random.default_rng(0)
    blinks_of = [np.flatnonzero(looks.at_s == at_s) for at_s in starts_s]
    halves = blinks_of[: len(blinks_of) // 2], blinks_of[len(blinks_of) // 2 :]

    def latency(pictures: Sequence[Indices]) -> float:
        at = np.concatenate(pictures)
        return _between(lag_s[at], whole[at], interval_s / 2)

    minutes = (starts_s[len(halves[0]) :].mean() - starts_s[: len(halves[0])].mean()) / 60
    early, later = map(latency, halves)
    others = [[latency([half[k] for k in drawn.integers(len(half), size=len(half))]) for half in halves] for _ in range(DRAWS)]
    return BlinkResult(
        latency_s,
        MARGIN * needed_s(lag_s[~whole] - latency_s, looks.late_s[~whole]) + MARGIN_S,
        max(latency_s - begins_s, 0.0),
        (float(np.median(first)), float(np.quantile(first, 0.95)), float(first.max())),
        ((later - early) / minutes, float(np.diff(others).std()) / minutes),
        (interval_s, float(looks.intervals_s.max())),
        looks.queued,
        blinks,
    )


def _show(rig: Rig, shine: Shine) -> None:
    """Show light at once. Raises LuxloopError where a limit forbids that."""
    rig.keeper.beat()
    given = rig.limit(shine, time.monotonic())
    if given.slowed < 1:
        raise LuxloopError("limits.change_per_s: is too low for a blink; give a lower --level, or raise it")
    rig.show(given.shine)


def _pictures(rig: Rig, until_s: float) -> Iterator[tuple[CameraPicture, Image]]:
    """Pictures as they come, as long as the camera lives."""
    while time.monotonic() < until_s:
        rig.keeper.beat()
        if not rig.camera.alive:
            return  # the light is dark then, and the blink void
        picture = rig.camera.next(min(until_s, time.monotonic() + 0.1))
        if picture is not None:
            try:
                yield picture, grey(picture.data).astype(np.float32)
            except WrongPicture:
                continue


def _steady(images: list[Image]) -> Image:
    """The last half of them `[n, height, width]`, 20 at most. Raises LuxloopError where there are too few, or their sizes differ."""
    last = images[len(images) // 2 :][-20:]
    if len(last) < 3 or len({each.shape for each in last}) > 1:
        raise LuxloopError("blink: too few pictures came, or of different sizes; see `luxloop rig check`")
    return np.stack(last)


def _region(dark: Image, bright: Image) -> tuple[Image, Mask]:
    """Which pixels show the light, and the rows in which there are some. Raises LuxloopError where none do."""
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
    """steady: dark and bright rows of pixels, both `[n, rows]`. came: intervals between the pictures, and share that lay in a queue."""
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
    """The mean time from which pictures are `after`, of those within `reach_s` around the time that parts them best."""
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
