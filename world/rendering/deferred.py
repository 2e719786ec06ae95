"""Depths and normals straight from OpenGL for moving worlds: less exact than ray intersections, but several times as fast."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files
from weakref import WeakKeyDictionary, finalize

import numpy as np
import torch
from torch import Tensor

from luxloop.world.caches import Part
from luxloop.world.frames import View, inverse
from luxloop.world.rendering.rasterise import FAR_M, NEAR_M, context
from luxloop.world.scene.body import Body
from luxloop.world.scene.triangles import Instance, Triangles

PART_BITS = 6  # body and part numbers share a float's 24 bits
MOST_PARTS = 2**PART_BITS
MARGIN_PX = 1  # margin drawn around a part
_GONE: deque[tuple[int, list[int]]] = deque()  # buffers of deleted bodies, released at the next draw call
KEPT = 8  # views with a cached image of static bodies


@dataclass(frozen=True)
class Fragments:
    """OpenGL's result at each pixel's centre; all zero without a surface.

    depth: `[height, width]` m along the optical axis. normal: `[3, height, width]`, unit, in the view's frame.
    object_id: `[height, width]` int32, -1 = none. part: `[height, width]` int32, which of its body's parts.
    """

    depth: Tensor
    normal: Tensor
    object_id: Tensor
    part: Tensor


class DeferredRenderer:
    """Draws placed bodies into a buffer of floats, and reads it back. Corners are snapped to 1/256 px or so.

    Bodies that have not moved since a view's last image are not drawn again for it.

    All instances share the process's one context; use them from one thread.
    """

    def __init__(self) -> None:
        """Raises NoOpenGL."""
        context()
        self._arrays: WeakKeyDictionary[Body, tuple[int, int]] = WeakKeyDictionary()
        self._still: dict[tuple[float, ...], tuple[tuple[Instance, ...], Tensor | None]] = {}  # key: parameters of the view and its part

    def fragments(self, triangles: Triangles, view: View, part: Part | None = None) -> Fragments:
        """Draw the triangles as `view` sees them; a part equals that part of the whole to the bit."""
        part = part or (slice(0, view.height), slice(0, view.width))
        depth, number, x, y = self._image(triangles.placed, view, part).permute(2, 0, 1).contiguous()
        code = number.int().abs_()
        object_id = (code >> PART_BITS).sub_(1)
        z = (object_id >= 0).float().sub_(x * x).sub_(y * y).clamp_(min=0).sqrt_().copysign_(-number)
        return Fragments(depth, torch.stack([x, y, z]), object_id, code.bitwise_and_(MOST_PARTS - 1))

    def _image(self, placed: tuple[Instance, ...], view: View, part: Part) -> Tensor:
        """`[height, width, 4]` of the part, depth first, zero where there is nothing."""
        placed, edges = _in_sight(placed, view, part), (end for each in part for end in (each.start, each.stop))
        numbers = (view.width, view.height, view.fx, view.fy, view.cx, view.cy, *edges, *view.T_world_view.flatten().tolist())
        last, image = self._still.pop(numbers, ((), None))
        still = tuple(each for each in last if each in placed)
        if still and (image is None or len(still) < len(last)):
            image = self._draw(still, view, part)
        moved = tuple(each for each in placed if each not in still)
        if len(self._still) == KEPT:
            del self._still[next(iter(self._still))]  # the least recently used
        self._still[numbers] = (still, image) if still else (placed, None)
        if image is None or not still:
            return self._draw(placed, view, part)
        over = self._draw(moved, view, part)
        depth, behind = over[..., :1], image[..., :1]
        return torch.where((depth > 0) & ((behind == 0) | (depth < behind)), over, image)

    def _draw(self, bodies: Sequence[Instance], view: View, part: Part) -> Tensor:
        from OpenGL import GL

        context()
        _delete_gone()
        program = _program()
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, _sized_framebuffer(view.width, view.height))
        GL.glViewport(0, 0, view.width, view.height)
        for state in (GL.GL_BLEND, GL.GL_MULTISAMPLE):
            GL.glDisable(state)
        for state in (GL.GL_DEPTH_TEST, GL.GL_SCISSOR_TEST):  # a smaller viewport would round corners differently
            GL.glEnable(state)
        GL.glScissor(*_rectangle(part))
        GL.glDepthMask(GL.GL_TRUE)
        GL.glDepthFunc(GL.GL_LESS)
        GL.glFrontFace(GL.GL_CW)  # the image is upside down to OpenGL
        GL.glCullFace(GL.GL_BACK)
        GL.glClearBufferfv(GL.GL_COLOR, 0, np.zeros(4, np.float32))
        GL.glClearBufferfv(GL.GL_DEPTH, 0, np.ones(1, np.float32))
        GL.glUseProgram(program)
        at = {name: GL.glGetUniformLocation(program, name) for name in ("T_view_body", "projection", "number", "two_sided")}
        GL.glUniformMatrix4fv(at["projection"], 1, GL.GL_TRUE, _projection(view))
        T_view_world = inverse(view.T_world_view)
        for placed in bodies:
            array, count = self._array_of(placed.body)
            T_view_body = T_view_world @ placed.T_world_body
            T_view_body[:3, 3] += T_view_body[:3, :3] @ _middle(placed.body)
            GL.glUniformMatrix4fv(at["T_view_body"], 1, GL.GL_TRUE, T_view_body.float().numpy())
            GL.glUniform1f(at["number"], float(MOST_PARTS * (placed.object_id + 1)))
            GL.glUniform1i(at["two_sided"], placed.body.two_sided)
            (GL.glDisable if placed.body.two_sided else GL.glEnable)(GL.GL_CULL_FACE)
            GL.glBindVertexArray(array)
            GL.glDrawElements(GL.GL_TRIANGLES, count, GL.GL_UNSIGNED_INT, None)
        GL.glBindVertexArray(0)
        GL.glUseProgram(0)
        GL.glFrontFace(GL.GL_CCW)  # which pyrender takes for granted
        GL.glDisable(GL.GL_SCISSOR_TEST)
        return _read(part)

    def _array_of(self, body: Body) -> tuple[int, int]:
        """A body's vertex array and its number of corners, uploaded on first use and deleted with the body."""
        if body not in self._arrays:
            if body.smooth and body.part_of_face is None:
                faces, n = np.asarray(body.mesh.faces), len(body.mesh.vertices)
                places = body.mesh.vertices - _middle(body).numpy()
                corners = np.concatenate([places, body.mesh.vertex_normals, np.zeros((n, 1))], axis=1)
            else:
                part = torch.zeros(len(body.corners)) if body.part_of_face is None else body.part_of_face
                places = body.corners - _middle(body)
                corners = torch.cat([places, body.corner_normals, part[:, None, None].expand(-1, 3, 1)], -1).flatten(0, 1).numpy()
                faces = np.arange(len(corners))
            array, buffers = _upload(corners, faces)
            finalize(body, _GONE.append, (array, buffers)).atexit = False  # when the context may be gone
            self._arrays[body] = (array, faces.size)
        return self._arrays[body]


def _middle(body: Body) -> Tensor:
    """Centre of the bounding box, `[3]` m, the origin of uploaded corners: float32 would shift a road 1.5 km from the world's origin by
    0.01 mm.
    """
    return body.bounds.mean(0)


def _upload(corners: np.ndarray, faces: np.ndarray) -> tuple[int, list[int]]:
    from OpenGL import GL

    array, buffers = int(GL.glGenVertexArrays(1)), [int(each) for each in GL.glGenBuffers(2)]
    GL.glBindVertexArray(array)
    for target, buffer, values in (
        (GL.GL_ARRAY_BUFFER, buffers[0], np.ascontiguousarray(corners, np.float32)),
        (GL.GL_ELEMENT_ARRAY_BUFFER, buffers[1], np.ascontiguousarray(faces, np.uint32)),
    ):
        GL.glBindBuffer(target, buffer)
        GL.glBufferData(target, values.nbytes, values, GL.GL_STATIC_DRAW)
    for location, size in enumerate((3, 3, 1)):
        GL.glEnableVertexAttribArray(location)
        GL.glVertexAttribPointer(location, size, GL.GL_FLOAT, GL.GL_FALSE, 28, GL.ctypes.c_void_p(12 * location))
    GL.glBindVertexArray(0)
    return array, buffers


def _delete_gone() -> None:
    """Delete buffers of deleted bodies in the thread of the OpenGL context, as a body may be deleted in another thread."""
    from OpenGL import GL

    while _GONE:
        array, buffers = _GONE.popleft()
        GL.glDeleteVertexArrays(1, [array])
        GL.glDeleteBuffers(len(buffers), buffers)


def _projection(view: View) -> np.ndarray:
    """From the view's frame (x right, y down, z forward) to clip space, row 0 of the image first in memory."""
    P = np.zeros((4, 4), np.float32)
    P[0, [0, 2]] = 2 * view.fx / view.width, 2 * view.cx / view.width - 1
    P[1, [1, 2]] = 2 * view.fy / view.height, 2 * view.cy / view.height - 1
    P[2, [2, 3]] = (FAR_M + NEAR_M) / (FAR_M - NEAR_M), -2 * FAR_M * NEAR_M / (FAR_M - NEAR_M)
    P[3, 2] = 1
    return P


def _in_sight(placed: tuple[Instance, ...], view: View, part: Part) -> tuple[Instance, ...]:
    """Bodies in the frustum of a part of a view: those whose bounding boxes do not lie wholly beyond one edge or behind the view."""
    if not placed:
        return placed
    corners = torch.stack([each.box for each in placed])  # [n, 8, 3]
    T = inverse(view.T_world_view)
    x, y, z = (corners @ T[:3, :3].T + T[:3, 3]).unbind(-1)
    (top, bottom), (left, right) = ((each.start - MARGIN_PX, each.stop + MARGIN_PX) for each in part)
    u, v = view.fx * x + view.cx * z, view.fy * y + view.cy * z  # px times depth
    beyond = torch.stack([u < left * z, u > right * z, v < top * z, v > bottom * z, z < 0]).all(-1).any(0)
    return tuple(each for each, hidden in zip(placed, beyond.tolist(), strict=True) if not hidden)


def _rectangle(part: Part) -> tuple[int, int, int, int]:
    """First column and row, width and height."""
    rows, columns = part
    return columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start


def _read(part: Part) -> Tensor:
    """`[height, width, 4]` float32."""
    from OpenGL import GL

    rectangle = _rectangle(part)
    pixels = np.empty((rectangle[3], rectangle[2], 4), np.float32)
    GL.glReadPixels(*rectangle, GL.GL_RGBA, GL.GL_FLOAT, pixels)
    GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, 0)
    return torch.from_numpy(pixels)


@cache
def _program() -> int:
    from OpenGL import GL
    from OpenGL.GL import shaders

    folder = files("luxloop.world.rendering") / "shaders"
    kinds = ((GL.GL_VERTEX_SHADER, "surfaces.vert"), (GL.GL_FRAGMENT_SHADER, "surfaces.frag"))
    return int(shaders.compileProgram(*(shaders.compileShader((folder / name).read_text(), kind) for kind, name in kinds)))


@cache
def _framebuffer() -> tuple[int, tuple[int, ...]]:
    """The framebuffer and its renderbuffers: surfaces, and OpenGL's own depth."""
    from OpenGL import GL

    return int(GL.glGenFramebuffers(1)), tuple(int(each) for each in GL.glGenRenderbuffers(2))


@lru_cache(1)
def _sized_framebuffer(width: int, height: int) -> int:
    """The framebuffer with storage for a view; reallocated only for another size."""
    from OpenGL import GL

    framebuffer, renderbuffers = _framebuffer()
    GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, framebuffer)
    places = ((GL.GL_COLOR_ATTACHMENT0, GL.GL_RGBA32F), (GL.GL_DEPTH_ATTACHMENT, GL.GL_DEPTH_COMPONENT24))
    for renderbuffer, (place, kind) in zip(renderbuffers, places, strict=True):
        GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, renderbuffer)
        GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, kind, width, height)
        GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, place, GL.GL_RENDERBUFFER, renderbuffer)
    return framebuffer
