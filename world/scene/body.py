"""Bodies: rigid triangle meshes on pose tracks over time, and figures, whose shape depends on the distance travelled."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from types import EllipsisType
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from luxloop.world.caches import keeping
from luxloop.world.frames import pose, rotation
from luxloop.world.materials.brdf import LAMBERTIAN, Material
from luxloop.world.materials.library import MaterialName, SpottedTexture, Texture
from luxloop.world.roads.base import Road
from luxloop.world.scene.embree import EmbreeMesh

if TYPE_CHECKING:
    import trimesh
    from scipy.spatial.transform import Slerp
from functools import cache
from typing import Final

# ahead and to the left: front left, front right, rear left, rear right
WHEELS = torch.tensor([[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, 1.0, -1.0]], dtype=torch.float64)


@dataclass(frozen=True)
class Part:
    """Appearance of a part of a body. name: such as "head" or "windscreen". albedo: 0..1."""

    name: str
    albedo: float
    material: MaterialName


@dataclass(frozen=True, eq=False)
class Spotlight:
    """A lamp of a body. Its intensity is Gaussian over the angle; its light casts no shadows.

    position, axis: `[3]`, m and unit, in the body frame. width_deg: standard deviations across and up. rgb: colour, linear sRGB at
    luminance 1.
    """

    position: Tensor
    axis: Tensor
    intensity_cd: float
    width_deg: tuple[float, float]
    rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Pose of a body over time, and the interval in which it exists: position linear, rotation on the shortest arc between keyframes,
    constant outside.

    times_s: K ascending times. T_world_body: `[K, 4, 4]` float64. The body exists in `[appears_s, vanishes_s)`. road: reference of heights
    at the body's x and y; None: z = 0. wheels_m: wheelbase and track, with which the body tilts as the road does; track 0: no roll; None:
    no tilt.
    """

    times_s: tuple[float, ...]
    T_world_body: Tensor
    appears_s: float = -float("inf")
    vanishes_s: float = float("inf")
    road: Road | None = None
    wheels_m: tuple[float, float] | None = None

    @classmethod
    def static(cls, T_world_body: Tensor | None = None) -> "PoseTrack":
        """A track with one constant pose `[4, 4]` (default: the world's origin)."""
        T = torch.eye(4, dtype=torch.float64) if T_world_body is None else T_world_body.double()
        return cls((0.0,), T[None])

    @cached_property
    def _travelled_m(self) -> np.ndarray:
        steps = np.diff(self.T_world_body[:, :3, 3].numpy(), axis=0)
        return np.cumsum([0.0, *np.linalg.norm(steps, axis=1)])

    def travelled_m(self, t_s: float) -> float:
        """Distance travelled in m until a time in s."""
        return float(np.interp(t_s, self.times_s, self._travelled_m))

    def visible_at(self, t_s: float) -> bool:
        return self.appears_s <= t_s < self.vanishes_s

    def pose_at(self, t_s: float) -> Tensor:
        """`T_world_body` `[4, 4]` float64 at a time in s; cached, since a step asks for the same pose repeatedly."""
        return self._pose_cache(t_s)

    @cached_property
    def _pose_cache(self) -> Callable[[float], Tensor]:
        return keeping(4, self._pose)

    def _pose(self, t_s: float) -> Tensor:
        T = self._interpolate(t_s)
        if self.road is None:
            return T
        R = T[:3, :3]
        if self.wheels_m is None:
            x, y = T[:2, 3].tolist()
            return pose(T[:3, 3] + T.new_tensor([0.0, 0.0, float(self.road.z(x, y))]), R)
        length, width = self.wheels_m
        x, y = (T[:2, 3:] + R[:2, :2] @ (T.new_tensor([[length / 2], [width / 2]]) * WHEELS)).numpy()
        z = torch.from_numpy(self.road.z(x, y))
        rise, lean = (z[:2] - z[2:]).mean(), (z[::2] - z[1::2]).mean()
        pitch, roll = -torch.atan2(rise, z.new_tensor(length)), torch.atan2(lean, z.new_tensor(width)) if width else z.new_zeros(())
        return pose(T[:3, 3] + torch.stack([z.new_zeros(()), z.new_zeros(()), z.mean()]), R @ rotation(roll, pitch, z.new_zeros(())))

    def _interpolate(self, t_s: float) -> Tensor:
        t = min(max(t_s, self.times_s[0]), self.times_s[-1])
        after = int(np.searchsorted(self.times_s, t))
        if self.times_s[after] == t:
            return self.T_world_body[after]
        start_s, stop_s = self.times_s[after - 1 : after + 1]
        start, stop = self.T_world_body[after - 1 : after + 1, :3, 3]
        return pose(torch.lerp(start, stop, (t - start_s) / (stop_s - start_s)), torch.from_numpy(self._rotation(t).as_matrix()))

    @cached_property
    def _rotation(self) -> "Slerp":
        """Rotation at a time."""
        from scipy.spatial.transform import Rotation, Slerp

        return Slerp(self.times_s, Rotation.from_matrix(self.T_world_body[:, :3, :3].numpy()))


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid mesh, compared by identity so that derived values can be cached.

    mesh: in the body frame, m. albedo: 0..1. texture: albedo and material over the body's x and y instead of the constants. smooth: vertex
    normals interpolated over a face (roads, people) instead of one normal a face (boxes). two_sided: faces are visible from both sides
    (sheets, open meshes), else only where their corners run counter-clockwise. parts: with albedos and materials of their own, in place of
    the body's. part_of_face: `[F]` int64, which of them a face belongs to. ground: a surface z(x, y), whose faces look up.
    """

    name: str
    mesh: "trimesh.Trimesh"
    albedo: float = 0.2
    texture: Texture | SpottedTexture | None = None
    material: Material = LAMBERTIAN
    smooth: bool = False
    two_sided: bool = False
    track: PoseTrack = field(default_factory=PoseTrack.static)
    parts: tuple[Part, ...] = ()
    part_of_face: Tensor | None = None
    spotlights: tuple[Spotlight, ...] = ()
    ground: bool = False

    @property
    def corners(self) -> Tensor:
        """Corners of the faces in the body frame, `[F, 3 corners, 3]` float64 m."""
        return self.corners_of(...)

    def corners_of(self, faces: np.ndarray | EllipsisType) -> Tensor:
        """`corners` of some faces."""
        return torch.from_numpy(np.asarray(self.mesh.vertices, np.float64)[np.asarray(self.mesh.faces)[faces]])

    @cached_property
    def bounds(self) -> Tensor:
        """Lowest and highest coordinates in the body frame, `[2, 3]` float64 m."""
        return torch.stack(self.corners.flatten(0, 1).aminmax(dim=0))

    @property
    def corner_normals(self) -> Tensor:
        """Unit normals at the corners in the body frame, `[F, 3 corners, 3]` float64; vertex normals are weighted by angle."""
        if self.smooth:
            return torch.from_numpy(np.array(self.mesh.vertex_normals)[np.asarray(self.mesh.faces)])
        a, b, c = self.corners.unbind(1)
        return torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=-1)[:, None].expand(-1, 3, -1).contiguous()

    @cached_property
    def embree(self) -> EmbreeMesh:
        """Embree's copy of the mesh. It ends with the body: embree crashes with about 1,000 of them at once."""
        vertices, faces = torch.from_numpy(np.array(self.mesh.vertices)), torch.from_numpy(np.array(self.mesh.faces))
        return EmbreeMesh(vertices, faces, torch.full((len(faces),), self.two_sided))


SHAPES: Final = 32  # of a cycle; a walker has one for every 5 cm


@dataclass(frozen=True, eq=False)
class Figure:
    """A body with a cycle of shapes.

    shape: makes the body at a phase 0..1 of the cycle; that body's track is not used. cycle_m: distance of a cycle. start: phase at the
    start of the way. shapes: number of them in a cycle.
    """

    name: str
    shape: Callable[[float], Body]
    cycle_m: float
    track: PoseTrack
    start: float = 0.0
    shapes: int = SHAPES

    def phase_at(self, t_s: float) -> float:
        """Phase 0..1 of the cycle at a time, in steps of one shape."""
        return round((self.start + self.track.travelled_m(t_s) / self.cycle_m) * self.shapes) % self.shapes / self.shapes

    def at(self, t_s: float) -> Body:
        """The shape at a time."""
        return self.shape_at(self.phase_at(t_s))

    @cached_property
    def bounds(self) -> Tensor:
        """Lowest and highest coordinates of all shapes in the body frame, `[2, 3]` float64 m."""
        low, high = torch.stack([self.shape_at(k / self.shapes).bounds for k in range(self.shapes)], 1)
        return torch.stack([low.amin(0), high.amax(0)])

    @cached_property
    def shape_at(self) -> Callable[[float], Body]:
        """`shape`, memoised to reuse values derived from a body."""
        return cache(self.shape)


TEXEL_M: Final = 0.05
MOST_TEXELS: Final = 2_000_000

Corner = tuple[float, float]


def albedo_picture(body: Body) -> tuple[Tensor, Corner, Corner]:
    """Albedo `[rows, columns]` over x and y of a body with a texture, x along columns, and the least and the greatest corner in m."""
    assert body.texture is not None
    (x0, y0), (x1, y1) = (each[:2].tolist() for each in body.bounds)
    texel_m = max(TEXEL_M, ((x1 - x0) * (y1 - y0) / MOST_TEXELS) ** 0.5)
    columns, rows = (max(round(side / texel_m), 1) for side in (x1 - x0, y1 - y0))
    x, y = (a + (torch.arange(n, dtype=torch.float64) + 0.5) * (b - a) / n for a, b, n in ((x0, x1, columns), (y0, y1, rows)))
    picture = body.texture.at(x.expand(rows, -1).contiguous(), y[:, None].expand(-1, columns).contiguous())
    return picture, (x0, y0), (x1, y1)
