"""Common base of random objects: named parts, whose material and albedo can be set."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import torch
from pydantic import Field

from luxloop.world.errors import LuxloopError, did_you_mean
from luxloop.world.materials.library import MaterialName
from luxloop.world.params import Params
from luxloop.world.scene.body import Body, Part, PoseTrack, Spotlight
from luxloop.world.traffic.shapes import Piece, joined
from luxloop.world.traffic.tracked import TrackedParams

Looks = Mapping[str, tuple[MaterialName, float]]  # material and albedo of parts, by their names

# Parts through which road users see: light on them dazzles.
EYES = frozenset({"head", "hair", "helmet", "windscreen"})


class SurfaceParams(Params):
    """Albedo and material of a part; by default from the seed."""

    albedo: float | None = Field(None, ge=0, le=1, description="diffuse albedo")
    material: MaterialName | None = Field(None, description="material by name")


def check_parts(owner: str, given: Iterable[str], names: Sequence[str]) -> None:
    """Raises LuxloopError where an object is given a part that it has not."""
    for name in given:
        if name not in names:
            raise LuxloopError(f"object {owner!r}: parts: there is no part {name!r}; {did_you_mean(name, names)}")


class MadeParams(TrackedParams):
    """An object made from a seed."""

    seed: int = Field(0, ge=0, lt=2**63, description="seed of proportions, clothes and colours")
    parts: dict[str, SurfaceParams] = Field({}, description="albedo and material of parts by name, instead of those from the seed")

    def random(self) -> np.random.Generator:
        return np.random.default_rng(self.seed)

    def made(self, pieces: Sequence[Piece], looks: Looks, track: PoseTrack, spotlights: tuple[Spotlight, ...] = ()) -> Body:
        """The body of pieces. Raises LuxloopError where `parts` names one that it has not."""
        mesh, names, of_face = joined(list(pieces))
        check_parts(self.name, self.parts, names)
        parts = tuple(self._part(name, *looks[name]) for name in names)
        return Body(self.name, mesh, smooth=True, track=track, parts=parts, part_of_face=torch.from_numpy(of_face), spotlights=spotlights)

    def _part(self, name: str, material: MaterialName, albedo: float) -> Part:
        given = self.parts.get(name, SurfaceParams())
        return Part(name, albedo if given.albedo is None else given.albedo, given.material or material)
