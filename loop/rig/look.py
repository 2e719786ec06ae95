"""Check of a dark rig: the pictures of its camera, and whether they fit a scenario."""

import time
from collections import Counter
from typing import Any, Final

import numpy as np

from luxloop.loop.rig.rectified import WrongPicture, grey
from luxloop.loop.rig.rig import Rig, await_camera
from luxloop.world.errors import LuxloopError

LOOK_S: Final = 3.0


def look(rig: Rig, seconds: float = LOOK_S) -> dict[str, Any]:
    """Rate, sizes and brightness of the camera's pictures in some seconds. Raises LuxloopError if fewer than two arrive."""
    if not await_camera(rig):
        raise LuxloopError(rig.camera.reason)
    rig.camera.forget()
    arrivals, late, sizes, brightest, refused = [], 0, set[tuple[int, int]](), 0.0, Counter[str]()
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        if rig.params.triggered:
            rig.camera.trigger()
        if (picture := rig.camera.next(until_s)) is None:
            break
        arrivals.append(picture.arrived_s)
        late += not picture.awaited
        try:
            image = grey(picture.data)
            sizes.add((image.shape[1], image.shape[0]))
            brightest = max(brightest, float(image.max()) / (2 ** (rig.params.camera.bits or 8 * image.dtype.itemsize) - 1))
            if rig.rectifier is not None:
                rig.rectifier.image(picture.data)
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
