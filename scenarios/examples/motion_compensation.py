"""A symbol that stays in its place while the car drives: drawn for the pose that the body will have when it is shown.

    luxloop new --like motion_compensation.py
    luxloop run driving --controller motion_compensation:MotionCompensation

The body is a spring on the ground, its attitude q (heave, roll, pitch) predicted over the delay t of the sensors: q + t q' - (2 pi f)^2 q
t^2 / 2. The road's height is where light and sight meet: the lamp's ray through the middle of the symbol, and the camera's ray to where it
is seen. It reads the default features, the symbol's middle in the camera's image.
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from luxloop import Ego, ExtractionStatus, Observation, ProjectionCommand, SymbolSensor


@dataclass(frozen=True)
class State:
    """place: `[4]`, pose of the symbol in the ground frame. height: `[]` m, of the road there over the plane of the ground."""

    place: Tensor
    height: Tensor


class MotionCompensation:
    """gain: share of a new height that is believed. spring_hz: natural frequency of the body. highest_m: limit of heights."""

    def __init__(self, sensor: SymbolSensor, gain: float = 0.7, spring_hz: float = 1.4, highest_m: float = 0.15) -> None:
        self.gain, self.stiffness, self.highest_m = gain, (2 * math.pi * spring_hz) ** 2, highest_m
        self.target, self.middle = sensor.projector.target, sensor.model.target[:2]
        self.view = sensor.model.eye.view  # of a body that rests
        self.camera = self.view.origin.to(self.target)
        self.lamp = torch.stack([module.T_body_headlight[:3, 3] for module in sensor.projector.modules]).mean(0).to(self.target)
        sight = self.sight(self.middle)
        self.offset = (self.camera - self.camera[2] / sight[2] * sight)[:2] - self.target[:2]  # of its centroid from its centre

    def start(self, pose: Tensor) -> State:
        return State(pose, pose.new_zeros(()))

    def projection(self, state: State, ego: Ego | None) -> ProjectionCommand:
        x, y, roll, pitch = state.place
        T = self.T_ground_body(ego, ego.time_s) if ego else torch.eye(4).to(x)
        camera = T[:3, :3] @ self.camera + T[:3, 3]
        place = torch.stack([x, y, torch.zeros_like(x)])
        road = place + state.height / camera[2] * (camera - place)  # where the sight of the place meets the road
        R = T[:3, :3].T
        centre = R @ (road - T[:3, 3])
        return ProjectionCommand(torch.stack([centre[0], centre[1], roll + R[2, 1], pitch - R[2, 0]]), z=centre[2])

    def step(self, state: State, observation: Observation) -> State:
        if observation.measurement.code != ExtractionStatus.SEEN:
            return State(self.target, (1 - self.gain) * state.height)
        lit = self.lit(observation)
        if observation.ego and observation.shown.ego:
            T = self.T_ground_body(observation.ego, observation.shown.ego.time_s)
            lit = T[:3, :3] @ lit + T[:3, 3]
        height = state.height + self.gain * (lit[2] - state.height)
        return State(self.target, height.clamp(-self.highest_m, self.highest_m))

    def T_ground_body(self, ego: Ego, time_s: float) -> Tensor:
        """The body's pose `[4, 4]` at a time, level where it is not measured."""
        late_s = 0.0 if math.isnan(ego.attitude_s) else time_s - ego.attitude_s
        bend = -self.stiffness * ego.attitude * late_s**2 / 2
        moved = ego.at(time_s)
        return replace(moved, attitude=(moved.attitude + bend).nan_to_num()).T_ground_body.to(self.target)

    def lit(self, observation: Observation) -> Tensor:
        """Where the middle of the symbol lies on the road, `[3]` m in the body frame: camera + s sight = lamp + t light."""
        projection = observation.shown.projection
        z = torch.zeros_like(projection.pose[0]) if projection.z is None else projection.z
        light = torch.cat([projection.pose[:2] + self.offset, z[None]]) - self.lamp
        sight = self.sight(self.middle + observation.measurement.errors[:2])
        upright = [0, 2]  # lamp and camera lie above each other: their rays cross in x and z
        s, _ = torch.linalg.solve(torch.stack([sight, -light], 1)[upright], (self.lamp - self.camera)[upright])
        return self.camera + s * sight

    def sight(self, pixel: Tensor) -> Tensor:
        """Direction `[3]` in the body frame of what is seen at (u, v)."""
        u, v = pixel
        ray = torch.stack([(u - self.view.cx) / self.view.fx, (v - self.view.cy) / self.view.fy, torch.ones_like(u)])
        return self.view.T_world_view[:3, :3].to(ray) @ ray
