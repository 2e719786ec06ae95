"""A step for the studio's clients: poses, bodies, light and pictures, made in the simulation's thread."""

import json
import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from luxloop.loop.report.picture import captions, marks
from luxloop.loop.simulation.columns import loss_name
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studio.messages import PICTURES, View
from luxloop.world.frames import transform
from luxloop.world.headlight.lamp import REST
from luxloop.world.scene.triangles import NOTHING, Instance, Triangles
from luxloop.world.scene.vehicle import STANDING

Pictures = dict[str, np.ndarray]  # `[height, width]` uint8, by name


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A step for clients.

    plain: its head, compressed. lights: utilisations `[n_p]` times commanded intensity, one per module; an unchanged tensor is shared with
    the previous step. pictures: requested ones by the names of `PICTURES`. views: requested contents. exact: arrays for programs.
    """

    step: int
    plain: bytes
    lights: tuple[Tensor, ...]
    pictures: Pictures
    views: frozenset[View]
    exact: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def head(self) -> dict[str, Any]:
        """Head of the message."""
        head: dict[str, Any] = json.loads(zlib.decompress(self.plain))
        return head

    def bytes_beside(self, before: "Snapshot | None") -> int:
        """Bytes of light and pictures that the previous snapshot does not share."""
        shared = set() if before is None else {id(u) for u in before.lights}
        return sum(u.nbytes for u in self.lights if id(u) not in shared) + sum(picture.nbytes for picture in self.pictures.values())


def bodies_at(simulation: Simulation, time_s: float, before: Triangles) -> Triangles:
    """Bodies at a time, if the plant knows them. before: those of another time."""
    world = simulation.truth
    return NOTHING if world is None else world.scene.at(time_s, world.motion.at(time_s).T_world_ground, before)


def snapshot(
    simulation: Simulation, result: Evaluation, bodies: Sequence[tuple[int, Instance]], before: Snapshot | None, wanted: Collection[View]
) -> Snapshot:
    """Snapshot of the last step, made in the simulation's thread, since it renders.

    bodies: with the numbers of their meshes. before: snapshot of the previous step. wanted: contents that clients show.
    """
    world, time_s = simulation.truth, result.time_s
    vehicle = (STANDING if world is None else world.motion).at(time_s)
    T_world_ground, T_world_body = vehicle.T_world_ground, vehicle.T_world_body
    spotlights = () if world is None else world.scene.spotlights_at(time_s)
    resting = [each.T_body_headlight for each in world.modules] if world else [each.T_world_module for each in simulation.modules]
    commands = result.now.commands or (REST,) * len(resting)
    lights = tuple(
        _reuse(command.intensity * u if command.intensity != 1 else u, None if before is None else before.lights[k])
        for k, (u, command) in enumerate(zip(result.lights, commands, strict=True))
    )
    head = {
        "step": result.step,
        "time_s": time_s,
        "T_world_ground": _numbers(T_world_ground),
        "T_world_body": _numbers(T_world_body),
        "T_world_camera": _numbers((simulation.view if world is None else world.view_at(time_s)).T_world_view),
        "modules": [
            {"T_world_module": _numbers(T_world_body @ command.turn(T.double().cpu()))}
            for T, command in zip(resting, commands, strict=True)
        ],
        "bodies": [{"mesh": number, "T_world_body": _numbers(each.T_world_body)} for number, each in bodies],
        "spotlights": [
            {
                "position_m": each.position.tolist(),
                "axis": each.axis.tolist(),
                "intensity_cd": each.intensity_cd,
                "width_deg": list(each.width_deg),
            }
            for each in spotlights
        ],
        "symbols": {name: _symbol(simulation, result, name, T_world_ground) for name in result.held},
        "marks": [vars(each) for each in marks(result, simulation)] if "marks" in wanted else [],
        "notes": [text for text, _ in captions(result, simulation)[2:]],  # without name and step
    }
    more, arrays = _exact(simulation, result, wanted)
    return Snapshot(result.step, plain({**head, **more}), lights, _pictures(simulation, result, wanted), frozenset(wanted), arrays)


def plain(head: Mapping[str, Any]) -> bytes:
    """Compressed head, a tenth of its size."""
    return zlib.compress(json.dumps(head).encode(), 1)


def _reuse(u: Tensor, before: Tensor | None) -> Tensor:
    u = u.detach().cpu()
    return before if before is not None and before.equal(u) else u


def _numbers(T: Tensor) -> list[float]:
    return [round(each, 6) for each in T.flatten().tolist()]


def _symbol(simulation: Simulation, result: Evaluation, name: str, T_world_ground: Tensor) -> dict[str, Any]:
    held, params = result.held[name], simulation.controlled[name].function.held
    x, y = params.length_m / 2, params.width_m / 2
    corners = torch.tensor([[x, x, -x, -x], [y, -y, -y, y], [0.0] * 4], dtype=torch.float64)
    there = corners + torch.tensor([[params.x_m], [params.y_m], [0.0]], dtype=torch.float64)
    target = transform(T_world_ground, there).T.tolist()
    return {"pose": held.pose.tolist(), "loss": loss_name(int(held.measurement.code)), "target": target}


def _pictures(simulation: Simulation, result: Evaluation, wanted: Collection[View]) -> Pictures:
    camera = simulation.scenario.camera
    frames: Iterable[tuple[View, Tensor]] = zip(("camera", "off"), _frames(result), strict=False)
    pictures = {PICTURES[view]: coded_frame(frame, 2**camera.bits - 1) for view, frame in frames if view in wanted}
    if "symbol" not in wanted:
        return pictures
    symbol = np.zeros((camera.height_px, camera.width_px), np.uint8)
    for held in result.held.values():
        seen = held.measurement
        if seen.symbol.numel():
            symbol[seen.crop.slices] = np.maximum(symbol[seen.crop.slices], (255 * seen.symbol.clamp(0, 1)).byte().cpu().numpy())
    return pictures | ({PICTURES["symbol"]: symbol} if symbol.any() else {})


def coded_frame(frame: Tensor, most: int) -> np.ndarray:
    """Frame coded as 255 times the square root of the share of the largest number, for even noise."""
    share = frame.float().cpu().numpy() / most
    coded: np.ndarray = (255 * np.sqrt(np.clip(share, 0, 1))).round().astype(np.uint8)
    return coded


def _exact(simulation: Simulation, result: Evaluation, wanted: Collection[View]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Exact contents for programs, head and arrays: digital numbers, and if the plant knows the truth depth, instances, materials and
    objects.
    """
    head, arrays = dict[str, Any](), dict[str, np.ndarray]()
    if "frames" in wanted:
        dtype = np.uint8 if simulation.scenario.camera.bits <= 8 else np.uint16
        arrays |= {name: _array(frame, dtype) for name, frame in zip(("frames.on", "frames.off"), _frames(result), strict=False)}
    if (world := simulation.truth) is None or not {"depth", "instances", "materials", "truth"} & set(wanted):
        return head, arrays
    lit = world.lit(result.time_s)
    if "depth" in wanted:
        arrays["depth"] = _array(lit.depth, np.float32)
    if "instances" in wanted:
        arrays["instances"], head["instances"] = _array(lit.surfaces.object_id + 1, np.uint16), [*world.instances]
    if "materials" in wanted:
        index, materials = lit.materials
        arrays["materials"], head["materials"] = _array(index + 1, np.uint8), ["", *materials]
    if "truth" in wanted:
        head["truth"] = [
            {
                "name": each.name,
                "instance": each.instance,
                "category": each.category,
                "T_world_object": each.boxed.T_world_object.flatten().tolist(),
                "size_m": each.boxed.size_m,
                "box": None if each.seen is None else each.seen.box,
                "visible": 0.0 if each.seen is None else each.seen.visible,
            }
            for each in world.objects_at(result.time_s)
        ]
    return head, arrays


def _array(values: Tensor, dtype: Any) -> np.ndarray:
    array: np.ndarray = np.ascontiguousarray(values.cpu().numpy(), dtype)
    return array


def _frames(result: Evaluation) -> tuple[Tensor, ...]:
    """Frames with all light, and, if symbols are held, without them."""
    return result.frames or (() if result.frame is None else (result.frame,))
