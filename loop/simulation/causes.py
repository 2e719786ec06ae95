"""Causes of a symbol's error: projections for the true pose of the body, for the true road, and for both."""

from dataclasses import replace

from torch import Tensor

from luxloop.controllers.symbol.heights.feedforward import height_map_of, region_around
from luxloop.controllers.symbol.heights.height_map import Belief
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.road_shape import HERE
from luxloop.loop.simulation.controlled import ControlledSymbol
from luxloop.world.frames import inverse, transform
from luxloop.world.roads.base import Road
from luxloop.world.scene.vehicle import VehicleState


def projections_by_cause(
    symbol: ControlledSymbol, belief: Belief | None, vehicle: VehicleState, road: Road
) -> dict[str, ProjectionCommand]:
    """Projections by column of `luxloop.loop.simulation.columns.CAUSES`: in open loop, and of a belief with pose, road and both made true.

    belief: of the controller; None: pose and road cannot be made true one by one. vehicle: the true one.
    """
    plane = HERE if belief is None else belief.T_ground_plane
    region = region_around(symbol.sensor) if belief is None else belief.relief.region
    projector, pose = symbol.projector, vehicle.T_ground_body
    true_eye = transform(inverse(plane) @ pose, projector.eye[:, None].to(pose))[:, 0]

    def seen_from(eye: Tensor) -> Belief:
        relief = height_map_of(road.z, region, eye, T_ground_plane=vehicle.T_world_ground @ plane)
        return Belief(relief, plane, pose)

    drawn = {"iou_open": ProjectionCommand(projector.target), "iou_true": seen_from(true_eye).draw(projector)}
    if belief is not None:
        drawn["iou_true_pose"] = replace(belief, T_ground_body=pose).draw(projector)
        drawn["iou_true_road"] = replace(seen_from(belief.relief.eye), T_ground_body=belief.T_ground_body).draw(projector)
    return drawn
