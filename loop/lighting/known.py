"""What is known of a view because it was rendered: where objects are, through which parts they see, and what all is made of."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from loop.lighting.view import LitScene
from loop.scenario.model import LightingScenario
from perception.detection.params import TruthParams
from perception.detection.protocol import Detections
from perception.ground_truth import Box, Truth, ground_truth, part_mask
from perception.materials import material_picture
from world.materials.library import MaterialName
from world.traffic.making import EYES
from world.traffic.tracked import ROAD_USERS, Category


def categories(scenario: LightingScenario) -> tuple[Category | None, ...]:
    """Classes of all objects as a detector ought to name them: cars without a category, the parked ones, are cars."""
    return tuple("car" if each.category is None and each.kind == "car" else each.category for each in scenario.all_objects)


@dataclass(frozen=True, eq=False)
class Known:
    """The truth about a view. categories: of the objects 1, 2, ..., as a detector ought to name them. told: as trackers are told."""

    lit: LitScene
    categories: Sequence[Category | None]
    told: Sequence[Category | None]

    @cached_property
    def objects(self) -> tuple[Truth, ...]:
        """Those with a class, of which a pixel is seen at least."""
        found = ground_truth(self.lit.surfaces, self.lit.triangles, self.lit.view, self.categories)
        return tuple(each for each in found if each.category is not None)

    @cached_property
    def pixels(self) -> tuple[Tensor, ...]:
        """Flat indices of those at which each of the objects 1, 2, ... is seen."""
        ids = self.lit.surfaces.object_id.flatten()
        seen = torch.nonzero(ids > 0)[:, 0]
        of_each = torch.bincount(ids[seen] - 1, minlength=len(self.categories)).tolist()
        return seen[ids[seen].argsort(stable=True)].split(of_each)

    @cached_property
    def boxes(self) -> Tensor:
        """`[n, 4]` px of all of `objects`, whether hidden or not, as far as in the image."""
        return torch.tensor([self._inside(each.whole) for each in self.objects], dtype=torch.float64).view(-1, 4)

    @cached_property
    def eyes(self) -> Tensor:
        """Heads and windscreens of road users that trackers are told of, `[height, width]` bool."""
        users = torch.tensor([number for number, each in enumerate(self.told, 1) if each in ROAD_USERS], dtype=torch.int32)
        ids = self.lit.surfaces.object_id
        return part_mask(self.lit.surfaces, self.lit.triangles, EYES) & torch.isin(ids, users.to(ids))

    @cached_property
    def materials(self) -> tuple[Tensor, tuple[MaterialName, ...]]:
        """Index `[height, width]` of what is seen in names of materials, -1 for none, and these."""
        return material_picture(self.lit.surfaces, self.lit.triangles)

    def detections(self, params: TruthParams, classes: tuple[Category, ...]) -> Detections:
        """What a detector finds that makes no mistakes."""
        height = self.boxes[:, 3] - self.boxes[:, 1]
        visible = torch.tensor([each.visible for each in self.objects], dtype=torch.float64)
        found = (height >= params.least_height_px) & (visible >= params.least_visible)
        numbers = torch.tensor([classes.index(each.category) for each in self.objects if each.category], dtype=torch.int64)
        scores = torch.nn.functional.one_hot(numbers, len(classes)).double()
        return Detections(self.boxes[found], scores[found])

    def _inside(self, box: Box) -> Box:
        width, height = self.lit.view.width, self.lit.view.height
        u0, u1 = (min(max(u, 0.0), width) for u in (box[0], box[2]))
        v0, v1 = (min(max(v, 0.0), height) for v in (box[1], box[3]))
        return u0, v0, u1, v1
