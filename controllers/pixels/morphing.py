"""Digital movement of a beam: SSC redraws its light texture from a moved screen before the lamp (T 7.3.2)."""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from luxloop.controllers.pixels.pixel_major import MrpcParams
from luxloop.controllers.pixels.primitives import Primitives, rectangle
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.world.frames import pose, rotation
from luxloop.world.headlight import Headlight

SCREEN_M = 25.0  # the usual distance of measuring screens; for rotations about the lamp it has no influence
STRAIGHT = MrpcParams(a_d=1.0)  # edge darkening, since otherwise a moved hot spot would light the border of the field (T fig. 7.18)


@dataclass(frozen=True)
class Morph:
    """Movement of a screen in eight degrees of freedom.

    T_headlight_screen: `[..., 4, 4]`; the identity does not move the beam, and rotations are about the photometric centre. width, height:
    stretch about the screen's middle.
    """

    T_headlight_screen: Tensor
    width: float = 1.0
    height: float = 1.0

    def then(self, other: "Morph") -> "Morph":
        """The composition: first this morph, then the other."""
        return Morph(other.T_headlight_screen @ self.T_headlight_screen, self.width * other.width, self.height * other.height)


def turn(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Morph:
    """Rotation about the lamp in rad: roll right side down, pitch nose down, yaw to the left."""
    return Morph(pose(torch.zeros(3, dtype=torch.float64), rotation(*torch.tensor([roll, pitch, yaw], dtype=torch.float64))))


def bend(yaw: float) -> Morph:
    """Bend lighting: rotation to the left, rad."""
    return turn(yaw=yaw)


def level(pitch: float) -> Morph:
    """Headlamp levelling: rotation down, rad."""
    return turn(pitch=pitch)


def roll(angle: float) -> Morph:
    """Compensation of the body's roll: rotation right side down, rad."""
    return turn(roll=angle)


def screen(texture: Tensor, headlight: Headlight, morph: Morph) -> Primitives:
    """The screen that shows a light texture `[rows, cols]` in cd, in the headlight's own frame; P = 1."""
    middle_y, middle_z = (headlight.left + headlight.right) / 2, (headlight.top + headlight.bottom) / 2
    half_y, half_z = morph.width * (headlight.left - headlight.right) / 2, morph.height * (headlight.top - headlight.bottom) / 2
    corners = [[1.0, middle_y + half_y, middle_z + half_z], [0.0, -2 * half_y, 0.0], [0.0, 0.0, -2 * half_z], [-1.0, 0.0, 0.0]]
    T = morph.T_headlight_screen.to(texture)[..., None, :, :]
    origin, d1, d2, normal = (SCREEN_M * (T[..., :3, :3] @ texture.new_tensor(vector)) for vector in corners)
    peak = texture.max().clamp(min=torch.finfo(texture.dtype).tiny)
    return rectangle(origin + T[..., :3, 3], d1, d2, peak, "I_v", normal=normal, symbol=texture / peak)


@dataclass(frozen=True)
class Morphing:
    """Digital movement of a beam, utilisation `[n_p]`. params: MRPC parameters of the moved beam."""

    headlight: Headlight
    beam: Tensor
    params: MrpcParams = STRAIGHT

    @cached_property
    def ssc(self) -> Ssc:
        return Ssc.prepare(self.headlight, self.params)

    @cached_property
    def texture(self) -> Tensor:
        """Light texture `[rows, cols]` in cd of the beam before it is moved."""
        return self.headlight.light_texture(self.beam.to(self.headlight.matrix.values))

    def utilisation(self, morph: Morph) -> Tensor:
        """Utilisation `[..., n_p]` of the moved beam; zero where its texture does not reach."""
        T = torch.eye(4, dtype=self.texture.dtype, device=self.texture.device)
        return self.ssc.utilisation(screen(self.texture, self.headlight, morph), T).u
