"""Deer and their gait."""

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from luxloop.world.scene.body import Body, Figure
from luxloop.world.traffic.shapes import Floats, Piece, ellipsoid, limb, tube, xyz
from luxloop.world.traffic.tracked import Looks, RandomParams, Reported

STRIDE = 1.4  # of the height of the shoulders
GAIT = (0.0, 0.5, 0.25, 0.75)  # left and right forelegs, then hind legs, of a walk


class AnimalParams(RandomParams):
    """A deer; the origin lies on the ground below its middle."""

    kind: Literal["animal"] = "animal"
    category: Reported = "animal"
    shoulder_m: float | None = Field(None, ge=0.4, le=2.2, description="shoulder height; left out: from the seed, 0.7 to 1.3 m")
    antlers: bool | None = Field(None, description="whether it has antlers; left out: from the seed, two in five have")

    def build(self) -> Body | Figure:
        """Raises LuxloopError where `parts` names an unknown part."""
        rng, track = self.random(), self.pose_track()
        height = rng.uniform(0.7, 1.3) if self.shoulder_m is None else self.shoulder_m
        antlers = rng.random() < 0.4 if self.antlers is None else self.antlers
        girth, grazing, start = rng.uniform(0.85, 1.2), rng.random() < 0.25, rng.random()
        fur = rng.uniform(0.08, 0.3)
        names = ("trunk", "head", "legs", "antlers", "tail")
        looks: Looks = {name: ("fur", fur) for name in names} | {"tail": ("fur", min(3 * fur, 0.6))}
        moves = len(track.times_s) > 1

        def shape(phase: float) -> Body:
            pieces = [*_trunk(girth, grazing and not moves, antlers), *_legs(phase, 1.0 if moves else 0.3)]
            return self.body([replace(piece, vertices=piece.vertices * height) for piece in pieces], looks, track)

        return Figure(self.name, shape, STRIDE * height, track, start) if moves else shape(start)


def _trunk(girth: float, grazing: bool, antlers: bool) -> list[Piece]:
    """Trunk, neck and head of an animal whose shoulders are 1 high."""
    at = np.array([[-0.68, 0.86], [-0.62, 0.87], [-0.45, 0.85], [-0.1, 0.8], [0.25, 0.79], [0.42, 0.81], [0.5, 0.83]])
    radii = np.array([[0.05, 0.06], [0.12, 0.13], [0.16, 0.19], [0.17, 0.2], [0.16, 0.22], [0.12, 0.18], [0.05, 0.09]]) * [girth, 1]
    pieces = [tube("trunk", np.stack([at[:, 0], 0 * at[:, 0], at[:, 1]], 1), radii, (0, 1, 0), 12)]
    neck = np.array([0.42, 0, 0.88])
    poll = np.array([0.85, 0, 0.4]) if grazing else np.array([0.72, 0, 1.36])
    nose = poll + ([0.14, 0, -0.24] if grazing else [0.27, 0, -0.13])
    pieces += [limb("trunk", neck, poll, 0.14 * girth, 0.075), limb("head", poll, nose, 0.085, 0.04)]
    for side in (-1, 1):
        ear = poll + xyz(-0.04, side * 0.06, 0.06)
        pieces.append(limb("head", ear, ear + xyz(-0.05, side * 0.12, 0.1), 0.035, 0.012, sides=6))
        if antlers:
            low, high = poll + xyz(0, side * 0.04, 0.07), poll + xyz(-0.08, side * 0.22, 0.4)
            pieces += [limb("antlers", low, high, 0.02, 0.014, sides=6)]
            pieces += [
                limb("antlers", low + f * (high - low), low + f * (high - low) + xyz(0.16, side * 0.02, 0.12), 0.014, 0.009, sides=6)
                for f in (0.3, 0.65, 1.0)
            ]
    return [*pieces, ellipsoid("tail", (-0.7, 0, 0.84), (0.035, 0.05, 0.1), sides=8, rings=6)]


def _legs(phase: float, swing: float) -> list[Piece]:
    pieces = []
    for k, start in enumerate(GAIT):
        fore, side = k < 2, 1.0 if k % 2 == 0 else -1.0
        angle = 2 * np.pi * (phase + start)
        forward, bend = swing * 0.33 * np.sin(angle), swing * 0.7 * max(np.cos(angle + 0.4), 0.0) ** 2
        hip = np.array([0.36 if fore else -0.5, side * 0.09, 0.72])
        first, second = (0.06, 0.06) if fore else (0.3, -0.18)
        knee = hip + 0.34 * _hanging(forward + first if fore else forward + first * 0.5)
        foot = knee + 0.35 * _hanging(forward - bend + (0 if fore else second))
        foot = foot if bend > 0.05 else np.array([*foot[:2], 0.03])
        pieces += [limb("legs", hip, knee, 0.085 if fore else 0.11, 0.042), limb("legs", knee, foot, 0.038, 0.028)]
    return pieces


def _hanging(forward: float) -> Floats:
    return np.array([np.sin(forward), 0.0, -np.cos(forward)])
