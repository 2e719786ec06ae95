"""Offscreen OpenGL, on a GPU or in software: draws placed bodies, and finds the triangle that each pixel of a view sees."""

import ctypes
import os
import resource
from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from functools import cache, lru_cache
from importlib.resources import files
from typing import Any, Final
from weakref import WeakKeyDictionary, finalize

import numpy as np
import torch
from torch import Tensor

from luxloop.world.caches import Part
from luxloop.world.errors import LuxloopError
from luxloop.world.frames import View, inverse
from luxloop.world.scene.body import Body
from luxloop.world.scene.triangles import Instance, Triangles

LEAST_ADDRESSES: Final = 6_000_000_000  # bytes of address space that torch, embree and OpenGL need


@cache
def _first_process() -> int:
    return os.getpid()


def check_process() -> None:
    """Raises LuxloopError in a fork of a process that has called this, as threads of torch, embree and OpenGL do not outlive a fork, and
    where `ulimit -v` leaves too few addresses."""
    if _first_process() != os.getpid():
        remedy = "start workers by 'spawn' or 'forkserver', such as AsyncVectorEnv(..., context='spawn')"
        raise LuxloopError(f"this process was forked from one that had simulated, and would wait for threads that it lacks; {remedy}")
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if 0 <= limit < LEAST_ADDRESSES:
        remedy = f"give `ulimit -v {LEAST_ADDRESSES // 1000}` or more; a limit on memory does no harm"
        raise LuxloopError(f"this process may have {limit / 1e9:.3g} GB of addresses, which is too little to simulate; {remedy}")


NEAR_M, FAR_M = 0.3, 1000.0  # 24 bits of depth between them: 0.7 mm at 60 m
EGL_PLATFORM_DEVICE = 0x313F
_GONE: deque[tuple[int, list[int]]] = deque()  # buffers of deleted bodies, released at the next draw call


class NoOpenGL(LuxloopError):
    """No offscreen OpenGL context can be made here."""


def context() -> None:
    """Make the one OpenGL context of the process current in this thread.

    Raises NoOpenGL; LuxloopError as `check_process`, in a second thread, and where others have ended EGL.
    """
    check_process()
    display, own = _context()
    from OpenGL import EGL, error

    try:
        EGL.eglMakeCurrent(display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, own)
    except error.GLError as failed:
        if failed.err == EGL.EGL_BAD_ACCESS:
            raise LuxloopError("another thread of this process renders; use luxloop from one thread, or from a process each") from failed
        remedy = "do not call pyrender's OffscreenRenderer.delete() before the last step, or take renderer=raycast"
        raise LuxloopError(f"this process's OpenGL context is gone, since other code has ended EGL; {remedy}") from failed


@cache
def _context() -> tuple[Any, Any]:
    """EGL's display and context of its first device. Raises NoOpenGL."""
    with suppress(ImportError):  # its LLVM crashes if it is loaded after that of Mesa's llvmpipe; torch's optimisers load it
        import triton  # noqa: F401
    try:
        if (platform := os.environ.setdefault("PYOPENGL_PLATFORM", "egl")) != "egl":
            raise ValueError(f"PYOPENGL_PLATFORM is {platform}, not egl")
        from OpenGL import EGL

        display, config, number = _display(), (EGL.EGLConfig * 1)(), EGL.EGLint()
        EGL.eglInitialize(display, EGL.EGLint(), EGL.EGLint())
        EGL.eglChooseConfig(display, _attributes(EGL.EGL_RENDERABLE_TYPE, EGL.EGL_OPENGL_BIT), config, 1, number)
        EGL.eglBindAPI(EGL.EGL_OPENGL_API)
        version = EGL.EGL_CONTEXT_MAJOR_VERSION, 3, EGL.EGL_CONTEXT_MINOR_VERSION, 3
        core = EGL.EGL_CONTEXT_OPENGL_PROFILE_MASK, EGL.EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT
        own = EGL.eglCreateContext(display, config[0], EGL.EGL_NO_CONTEXT, _attributes(*version, *core))
        EGL.eglMakeCurrent(display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, own)
    except Exception as error:  # missing libraries and drivers show as ImportError, AttributeError, EGLError ...
        reason = str(error) or type(error).__name__
        remedy = "install libegl1 and libgl1-mesa-dri, or take the face source 'raycast'"
        raise NoOpenGL(f"no offscreen OpenGL here ({reason}); {remedy}") from error
    return display, own


def _display() -> Any:
    """EGL's display of its first device, which needs no screen."""
    from OpenGL import EGL

    def function(name: str, *types: Any) -> Any:
        return ctypes.CFUNCTYPE(*types)(EGL.eglGetProcAddress(name))

    device, number, pointer = ctypes.c_void_p(), EGL.EGLint(), ctypes.c_void_p
    query = function("eglQueryDevicesEXT", EGL.EGLBoolean, EGL.EGLint, pointer, pointer)
    query(1, ctypes.byref(device), ctypes.byref(number))
    display = function("eglGetPlatformDisplayEXT", EGL.EGLDisplay, EGL.EGLenum, pointer, pointer)
    return display(EGL_PLATFORM_DEVICE, device, None)


def _attributes(*pairs: int) -> Any:
    from OpenGL import EGL

    return (EGL.EGLint * (len(pairs) + 1))(*pairs, EGL.EGL_NONE)


class Rasteriser:
    """Draws placed bodies, and is a face source. Corners are snapped to 1/256 px or so.

    All instances share the process's one context; use them from one thread.
    """

    def __init__(self) -> None:
        """Raises NoOpenGL."""
        context()
        from OpenGL import GL

        self._arrays: WeakKeyDictionary[Body, tuple[int, int]] = WeakKeyDictionary()
        self.name = f"OpenGL ({GL.glGetString(GL.GL_RENDERER).decode()})"

    def face_ids(self, triangles: Triangles, view: View, part: Part | None = None) -> Tensor:
        """As `FaceSource.face_ids`; a part equals that part of the whole."""
        if sum(placed.n_faces for placed in triangles.placed) >= 1 << 24:
            raise LuxloopError("the scene has more than 16.7 million triangles; take coarser meshes, or the face source 'raycast'")
        numbered = ((placed, first + 1) for first, placed in triangles.parts())  # 0: none
        return self.draw("faces", numbered, view, part or view.whole)[..., 0].long() - 1

    def draw(self, shader: str, numbered: Iterable[tuple[Instance, int]], view: View, part: Part) -> Tensor:
        """The fragment shader's output `[height, width, 4]` float32 at a part of a view, zero where there is nothing.

        numbered: bodies, each with the shader's `number`; of two surfaces at one depth the first drawn wins.
        """
        context()
        from OpenGL import GL

        _delete_gone()
        program = _program(shader)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, _sized_framebuffer(view.width, view.height))
        GL.glViewport(0, 0, view.width, view.height)
        for state in (GL.GL_DEPTH_TEST, GL.GL_SCISSOR_TEST):  # a smaller viewport would round corners differently
            GL.glEnable(state)
        GL.glScissor(*_rectangle(part))
        GL.glFrontFace(GL.GL_CW)  # the image is upside down to OpenGL
        GL.glClearBufferfv(GL.GL_COLOR, 0, np.zeros(4, np.float32))
        GL.glClearBufferfv(GL.GL_DEPTH, 0, np.ones(1, np.float32))
        GL.glUseProgram(program)
        at = {name: GL.glGetUniformLocation(program, name) for name in ("T_view_body", "projection", "number", "two_sided")}
        GL.glUniformMatrix4fv(at["projection"], 1, GL.GL_TRUE, _projection(view))
        T_view_world = inverse(view.T_world_view)
        for placed, number in numbered:
            array, count = self._array_of(placed.body)
            T_view_body = T_view_world @ placed.T_world_body
            T_view_body[:3, 3] += T_view_body[:3, :3] @ _middle(placed.body)
            GL.glUniformMatrix4fv(at["T_view_body"], 1, GL.GL_TRUE, T_view_body.float().numpy())
            GL.glUniform1f(at["number"], float(number))
            GL.glUniform1i(at["two_sided"], placed.body.two_sided)
            (GL.glDisable if placed.body.two_sided else GL.glEnable)(GL.GL_CULL_FACE)
            GL.glBindVertexArray(array)
            GL.glDrawElements(GL.GL_TRIANGLES, count, GL.GL_UNSIGNED_INT, None)
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
    return torch.from_numpy(pixels)


@cache
def _program(fragment: str) -> int:
    from OpenGL import GL
    from OpenGL.GL import shaders

    folder = files("luxloop.world.rendering") / "shaders"
    kinds = ((GL.GL_VERTEX_SHADER, "surfaces.vert"), (GL.GL_FRAGMENT_SHADER, f"{fragment}.frag"))
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
