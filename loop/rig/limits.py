"""Limits of the light: of its power, and of its change per second."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from luxloop.loop.rig.light import Picture, Shine
from luxloop.loop.rig.params import LimitParams


@dataclass(frozen=True, eq=False)
class Limited:
    """Light within the limits. dimmed: the factor by which the power limit dims it. slowed: the share of the requested change that is
    made, 1 for all of it.
    """

    shine: Shine
    dimmed: float = 1.0
    slowed: float = 1.0

    @property
    def whole(self) -> bool:
        """Whether it is the requested light."""
        return self.dimmed == 1 and self.slowed == 1


def limited(shine: Shine, before: Sequence[Picture] | None, passed_s: float, limits: LimitParams) -> Limited:
    """Light within limits. before: current pictures times the modules' intensities, None if dark. passed_s: time since they were sent.

    Light is dimmed by one factor. Of a change that is too fast, only a part is made, so that it is complete after some exposures.
    """
    share = shine.share
    factor = 1.0 if share <= limits.share else limits.share / share
    pictures = shine.pictures if factor == 1 else tuple(np.float32(factor) * u for u in shine.pictures)
    asked = replace(shine, pictures=pictures)
    old = tuple(np.zeros_like(u) for u in pictures) if before is None else tuple(before)
    count = sum(u.size for u in pictures)
    change = float(sum(np.abs(new - u).sum() for new, u in zip(asked.dimmed, old, strict=True))) / count
    most = limits.change_per_s * passed_s
    if change <= most:
        return Limited(asked, factor)
    part = most / change
    commands = shine.commands and tuple(replace(each, intensity=1.0) for each in shine.commands)
    between = tuple(u + np.float32(part) * (new - u) for new, u in zip(asked.dimmed, old, strict=True))
    return Limited(replace(asked, pictures=between, commands=commands), factor, part)
