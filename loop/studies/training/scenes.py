"""Training scenes for a detector, rendered once without headlamps as each pixel's response to light, so that any light can be applied."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor

from luxloop.loop.scenario.model import Scenario, validate
from luxloop.loop.simulation.simulated import build_scene
from luxloop.loop.studies.training.widening import crowd, widen_scene
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.perception.ground_truth import ground_truth
from luxloop.world.files import whole
from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight import Headlight
from luxloop.world.light.emitters import ambient_luminance
from luxloop.world.light.illumination import lit_surface, luminance
from luxloop.world.rendering.gbuffer import GBuffer
from luxloop.world.rendering.surfaces import SurfaceSource, face_source, surface_source
from luxloop.world.scene.scene import Ground, Scene
from luxloop.world.scene.triangles import Triangles
from luxloop.world.spmv import Csr
from luxloop.world.traffic.generator import random_tables
from luxloop.world.traffic.tracked import Category

CAMERA = CameraParams(width_px=640, height_px=360, pitch_deg=1.5, oversampling=1, saturation_e=2000)
LAMPS_M = ((0.0, 0.6, 0.75), (0.0, -0.6, 0.75))
CLASSES: tuple[Category, ...] = ("pedestrian", "cyclist", "car", "animal")
TRAINING, HELD_OUT = 10_000, 1_000_000  # first seeds of scenes; both sets have different objects
ROADS = 8  # roads of each set
SWAY = (1.5, 1.0, 2.5, 0.15)  # standard deviations of the camera's pitch, roll and yaw in deg, and of its height in m, in training
LARGEST = 6e4  # limit of half precision
MOMENTS_S = 4.0  # range of a scene's random time
Row = Mapping[str, Any]  # of a scene, from `draw`, with its seed and folder
LAYERS = ("lamps", "distance", "own", "sky", "object_id")


@dataclass(frozen=True)
class SceneObject:
    """An object of one of the classes.

    box: `[4]` px, left, top, right, bottom of visible and hidden parts, within the image. visible: share that nothing hides. inside: share
    of its whole box within the image.
    """

    object_id: int
    label: int
    box: tuple[float, float, float, float]
    visible: float
    inside: float

    @property
    def height(self) -> float:
        return self.box[3] - self.box[1]

    def within(self, left: int, top: int, width: int, height: int) -> "SceneObject | None":
        """The object in a part of the image, relative to that part; None outside."""
        u0, v0, u1, v1 = self.box
        box = (max(u0 - left, 0.0), max(v0 - top, 0.0), min(u1 - left, float(width)), min(v1 - top, float(height)))
        size, whole = (box[2] - box[0], box[3] - box[1]), (u1 - u0) * (v1 - v0)
        return replace(self, box=box, inside=self.inside * size[0] * size[1] / whole) if min(size) > 0 else None


@dataclass(frozen=True, eq=False)
class DarkScene:
    """A scene as the camera would see it in any light, all `[height, width]`.

    lamps: luminance in cd/m^2 per lx of light from both headlamps, half from each, on a surface facing them. distance: m to the middle
    between the headlamps. own: luminance by all other lamps. sky: luminance per lx of an overcast sky. object_id: -1 without an object.
    ambient_lx: of the scene's night. objects: visible objects of the classes.
    """

    lamps: Tensor
    distance: Tensor
    own: Tensor
    sky: Tensor
    object_id: Tensor
    ambient_lx: float
    objects: tuple[SceneObject, ...]

    @property
    def shape(self) -> tuple[int, int]:
        height, width = self.lamps.shape
        return height, width

    @cached_property
    def pixels(self) -> tuple[Tensor, Tensor]:
        """Places of the objects' pixels in the flattened image, and their objects, `[n]` each."""
        ids = self.object_id.flatten()
        at = torch.nonzero(ids > 0)[:, 0]
        return at, ids[at]

    def shift(self, left: int, top: int) -> "DarkScene":
        """Scene with the image origin at a column and row; boxes are clipped to the image."""
        return replace(self, objects=tuple(found for each in self.objects if (found := each.within(left, top, *self.shape[::-1]))))

    def mirror(self) -> "DarkScene":
        """Scene with left and right exchanged."""
        layers = {name: getattr(self, name).flip(-1) for name in LAYERS}
        width = self.shape[1]
        objects = tuple(replace(each, box=(width - each.box[2], each.box[1], width - each.box[0], each.box[3])) for each in self.objects)
        return replace(self, **layers, objects=objects)  # type: ignore[arg-type]

    def behind(self, other: "DarkScene") -> "DarkScene":
        """Scene with another scene's objects inserted by distance, without their shadows."""
        nearer = (other.object_id > 0) & (other.distance < self.distance)
        first = int(self.object_id.max()) + 1
        moved = replace(
            other,
            object_id=other.object_id + first,
            objects=tuple(replace(each, object_id=each.object_id + first) for each in other.objects),
        )
        layers = {name: torch.where(nearer, getattr(moved, name), getattr(self, name)) for name in LAYERS}
        objects = (*_in_sight(self, layers["object_id"]), *_in_sight(moved, layers["object_id"]))
        return replace(self, **layers, objects=objects)  # type: ignore[arg-type]


def _in_sight(scene: DarkScene, object_id: Tensor) -> tuple[SceneObject, ...]:
    """Objects of a scene that remain visible in an image in which others may hide them."""
    before, after = (torch.bincount(ids.flatten() + 1, minlength=256) for ids in (scene.object_id, object_id))
    share = (after / before.clamp(min=1)).tolist()
    return tuple(replace(each, visible=each.visible * share[each.object_id + 1]) for each in scene.objects)


def draw(seed: int, folder: str, wide: bool = False) -> dict[str, Any]:
    """Render the scene of a seed into `folder/SEED.npy`; returns its row. Raises LuxloopError on a write error.

    wide: with more kinds of bodies and roads, and a camera that looks elsewhere, for training alone.
    """
    scenario = _scenario(seed, wide)
    ground, source = _road(road_seed(seed), wide)
    time_s = float(np.random.default_rng([seed, 2]).uniform(0, MOMENTS_S))
    # parked cars count as cars, although trackers do not report them
    bodies = [(item.build(), "car" if item.kind == "car" else item.category) for item in scenario.all_objects]
    camera = CAMERA
    if wide:
        rng = np.random.default_rng([seed, 5])
        bodies = widen_scene(scenario.all_objects, ground.road, time_s, rng)
        camera = CAMERA.model_copy(
            update=dict(zip(("pitch_deg", "roll_deg", "yaw_deg", "z_m"), rng.normal((1.5, 0, 0, 1.35), SWAY), strict=True))
        )
    scene = Scene((ground, *(body for body, _ in bodies)), 0.0, scenario.light.street_lamps)
    triangles, view = scene.at(time_s), camera_view(camera)
    surfaces = source.gbuffer(triangles, view)
    here = surfaces.object_id >= 0
    away = surfaces.position - torch.tensor(LAMPS_M).mean(0)[:, None, None]
    distance = torch.where(here, away.norm(dim=0), torch.inf)
    dark = ambient_luminance(surfaces, 0.0, scene.street_lamps, scene.spotlights_at(time_s))
    sky = torch.where(here, surfaces.albedo * (1 + surfaces.normal[2]) / (2 * math.pi), 0)
    layers = torch.stack([_sent_back(surfaces, triangles, distance), distance, dark, sky, surfaces.object_id.float()])
    Path(folder).mkdir(parents=True, exist_ok=True)
    with whole(_file(folder, seed)) as part, part.open("wb") as stream:
        np.save(stream, layers.clamp(max=LARGEST).half().numpy())
    objects = [
        {
            "object_id": each.object_id,
            "label": CLASSES.index(each.category),
            "box": _within(each.whole),
            "visible": each.visible,
            "inside": each.inside,
        }
        for each in ground_truth(surfaces, triangles, view, [category for _, category in bodies])
        if each.category in CLASSES and each.inside > 0
    ]
    return {"ambient_lx": scenario.light.ambient_lx, "objects": objects}


def read(row: Row, rows: slice = slice(None), columns: slice = slice(None)) -> DarkScene:
    """Scene of a row from `draw`, or a part of its image, to which boxes are then relative. Raises OSError if the file is gone."""
    layers = np.load(_file(row["folder"], row["seed"]), mmap_mode="r")[:, rows, columns]
    lamps, distance, own, sky, object_id = torch.from_numpy(np.array(layers)).float()
    objects = tuple(SceneObject(**{**each, "box": tuple(each["box"])}) for each in row["objects"])
    scene = DarkScene(lamps, distance, own, sky, object_id.int(), row["ambient_lx"], objects)
    return scene.shift(columns.start or 0, rows.start or 0)


def _file(folder: str, seed: int) -> Path:
    return Path(folder) / f"{seed}.npy"


def tables(seed: int) -> dict[str, Any]:
    """Tables `road`, `surface`, `light` and `traffic` of a scenario from a seed, with an object in most scenes."""
    found = random_tables(seed)
    traffic = found["traffic"]
    for key in ("pedestrians", "cyclists", "animals"):  # real nights are emptier
        traffic[key] += 1
    return found


def _scenario(seed: int, wide: bool) -> Scenario:
    found = tables(seed)
    if wide:
        found |= crowd(found, road_seed(seed))
    return validate({"name": "training", "lighting": {}, **found}, f"seed {seed}")


def road_seed(seed: int) -> int:
    first = HELD_OUT if seed >= HELD_OUT else TRAINING
    return first + seed % ROADS


@lru_cache(1)  # 0.1 GB
def _road(seed: int, wide: bool) -> tuple[Ground, SurfaceSource]:
    scenario = _scenario(seed, wide).model_copy(update={"objects": (), "traffic": None})
    ground = build_scene(scenario).bodies[0]
    assert isinstance(ground, Ground)
    return ground, surface_source(face_source(), moving=True)


def _sent_back(surfaces: GBuffer, triangles: Triangles, distance: Tensor) -> Tensor:
    """Luminance in cd/m^2 per lx on a surface facing the lamps."""
    found = torch.zeros(distance.numel())
    even = Csr.from_scipy(sp.csr_matrix(np.ones((4, 1))))  # 1 cd into all directions that the camera sees
    lamp = Headlight(rows=2, cols=2, left=0.4, right=-0.4, bottom=-0.3, top=0.3, name="even", matrix=even, pixel_rows=1, pixel_cols=1)
    texture = lamp.light_texture(torch.ones(1))
    for place in LAMPS_M:
        T_world_lamp = pose_from_degrees(place)
        surface = lit_surface(surfaces, lamp, T_world_lamp, triangles)
        found[surface.index] += luminance(surface, texture) / len(LAMPS_M)
    return found.view_as(distance) * torch.where(distance.isfinite(), distance, 0).square()


def _within(box: tuple[float, float, float, float]) -> list[float]:
    (u0, v0, u1, v1), (w, h) = box, (CAMERA.width_px, CAMERA.height_px)
    return [min(max(value, 0.0), float(limit)) for value, limit in ((u0, w), (v0, h), (u1, w), (v1, h))]
