"""Why heads are dazzled, objects have no track, and tracks show no object: by the truth, for scenarios with `judge_causes`."""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Final

import torch
from torch import Tensor

from luxloop.loop.simulation.detection import Recognition, pairs
from luxloop.loop.simulation.world import LitScene
from luxloop.perception.detection.detector import SAME, Detections, overlaps
from luxloop.perception.tracking import TrackedBoxes

DAZZLING_LX: Final = 1.0  # on heads and windscreens
NEW_S: Final = 0.3  # time allowed to find an object and to dim for it
CLEAR: Final = 0.5  # least share of an object that is in sight

WHY: Final = {
    "dazzled_new": "road users with more than 1 lx on head or windscreen, in sight for less than 0.3 s",
    "dazzled_untracked": "road users with more than 1 lx on head or windscreen, in sight for longer, without a track",
    "dazzled_tracked": "road users with more than 1 lx on head or windscreen, in sight for longer, with a track",
    "untracked_new": "findable objects without a track, in sight for less than 0.3 s",
    "untracked_hidden": "findable objects without a track, in sight for longer, less than half of them",
    "untracked_found": "clear objects without a track that the detector finds in the frame",
    "untracked_dark": "clear objects without a track that the detector finds in full light only",
    "untracked_overlooked": "clear objects without a track that the detector finds in no light",
    "false_double": "tracks of an object that another track shows",
    "false_part": "tracks without an object, of which half lies within one",
    "false_nothing": "tracks without an object, of which less lies within one",
}  # columns and what they count


def attribute(
    view: LitScene,
    recognised: Mapping[str, Recognition],
    tracks: TrackedBoxes,
    eyes_lx: Mapping[str, float],
    seen_s: Mapping[str, float],
    find_in_full_light: Callable[[], Detections],
) -> Mapping[str, int]:
    """Number of heads, objects and tracks by column of `WHY`.

    view: of the camera at the time of the frame. eyes_lx: illuminance of heads and windscreens by road user. seen_s: time in s since an
    object came in sight. find_in_full_light: detects in a frame of the same view with all pixels on.
    """
    found = Counter[str]()
    for name, lx in eyes_lx.items():
        if lx > DAZZLING_LX:
            known = name in recognised and recognised[name].track is not None
            found["dazzled_new" if seen_s.get(name, 0.0) < NEW_S else "dazzled_tracked" if known else "dazzled_untracked"] += 1
    dark = list[int]()
    for k, each in enumerate(view.objects):
        its = recognised[each.name]
        if its.findable and its.track is None:
            if seen_s.get(each.name, 0.0) < NEW_S:
                found["untracked_new"] += 1
            elif min(each.visible, each.inside) < CLEAR:
                found["untracked_hidden"] += 1
            elif its.score:
                found["untracked_found"] += 1
            else:
                dark.append(k)
    if dark:
        lit = dict(pairs(view.boxes, find_in_full_light().boxes.double().cpu()))
        found.update("untracked_dark" if k in lit else "untracked_overlooked" for k in dark)
    shown = {row for _, row in pairs(view.boxes, tracks.boxes)}
    for row, (same, part) in enumerate(zip(overlaps(tracks.boxes, view.boxes), _within(tracks.boxes, view.boxes), strict=True)):
        if row not in shown:
            found["false_double" if bool((same >= SAME).any()) else "false_part" if bool((part >= 0.5).any()) else "false_nothing"] += 1
    return {why: found[why] for why in WHY}


def _within(boxes: Tensor, others: Tensor) -> Tensor:
    """Shares `[n, m]` of boxes `[n, 4]` that lie within others `[m, 4]`."""
    low, high = torch.maximum(boxes[:, None, :2], others[:, :2]), torch.minimum(boxes[:, None, 2:], others[:, 2:])
    return (high - low).clamp(min=0).prod(-1) / (boxes[:, 2:] - boxes[:, :2]).prod(-1, keepdim=True).clamp(min=1e-9)
