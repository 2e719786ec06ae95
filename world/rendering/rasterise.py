"""Which triangle each pixel of a view sees, by OpenGL: pyrender, offscreen, on a GPU or in software."""

import os
import resource
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, Final
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor

from luxloop.world.caches import Part
from luxloop.world.errors import LuxloopError
from luxloop.world.frames import View
from luxloop.world.scene.body import Body
from luxloop.world.scene.triangles import Triangles

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
EGL_BAD_ACCESS = 0x3002
GL_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL looks along -z, with y up


class NoOpenGL(LuxloopError):
    """No offscreen OpenGL context can be made here."""


class Rasteriser:
    """A face source by OpenGL. All instances share the process's one context; use them from one thread."""

    def __init__(self) -> None:
        """Raises NoOpenGL."""
        context()
        self._meshes: WeakKeyDictionary[Body, list[Any]] = WeakKeyDictionary()
        self.name = f"OpenGL ({_renderer_name()})"

    def face_ids(self, triangles: Triangles, view: View, part: Part | None = None) -> Tensor:
        """As `FaceSource`, to 1/256 px or so. The whole view is drawn: a smaller viewport would round corners differently."""
        import pyrender

        if sum(placed.n_faces for placed in triangles.placed) >= 1 << 24:
            raise LuxloopError("the scene has more than 16.7 million triangles; take coarser meshes, or the face source 'raycast'")
        scene = _ordered_scene()
        camera = pyrender.IntrinsicsCamera(view.fx, view.fy, view.cx, view.cy, NEAR_M, FAR_M)
        scene.add(camera, pose=view.T_world_view.numpy() @ GL_OPENCV)
        first_ids: dict[Any, list[int]] = {}
        for first, placed in triangles.parts():
            for mesh in self._meshes_of(placed.body):
                node = scene.add(mesh, pose=placed.T_world_body.numpy(), name=f"{len(first_ids):06}")
                # pyrender clears to 0, so ids in the picture begin with 1
                first_ids[node] = [((first + 1) >> shift) & 255 for shift in (0, 8, 16)]
        renderer = context()
        renderer.viewport_width, renderer.viewport_height = view.width, view.height
        rgb, _ = renderer.render(scene, pyrender.RenderFlags.SEG, first_ids)
        red, green, blue = torch.from_numpy(rgb[part or ...].copy()).permute(2, 0, 1).long()
        return red + (green << 8) + (blue << 16) - 1

    def _meshes_of(self, body: Body) -> list[Any]:
        if body not in self._meshes:
            sides = [np.asarray(body.mesh.faces)]
            if body.two_sided:
                # pyrender culls back faces, so the mesh is drawn a second time, inside out, with the same ids
                sides.append(sides[0][:, ::-1])
            self._meshes[body] = [_pyrender_mesh(body.mesh.vertices, faces) for faces in sides]
        return self._meshes[body]


def _pyrender_mesh(vertices: np.ndarray, faces: np.ndarray) -> Any:
    import pyrender

    return pyrender.Mesh([pyrender.Primitive(vertices, indices=faces, material=pyrender.MetallicRoughnessMaterial())])


def _ordered_scene() -> Any:
    import pyrender

    class OrderedScene(pyrender.Scene):
        """Draws in a fixed order (pyrender iterates over a set), since where surfaces meet the first one drawn wins."""

        @property
        def mesh_nodes(self) -> list[Any]:
            return sorted(super().mesh_nodes, key=lambda node: node.name)

    return OrderedScene()


def context() -> Any:
    """The one OffscreenRenderer of the process, current in this thread: pyrender's meshes belong to the context that first drew them.

    Raises NoOpenGL; LuxloopError as `check_process`, in a second thread, and where others have ended EGL.
    """
    check_process()
    renderer = _context()
    from OpenGL.error import GLError

    try:
        renderer._platform.make_current()
    except GLError as error:
        if error.err == EGL_BAD_ACCESS:
            raise LuxloopError("another thread of this process renders; use luxloop from one thread, or from a process each") from error
        remedy = "do not call pyrender's OffscreenRenderer.delete() before the last step, or take renderer=raycast"
        raise LuxloopError(f"this process's OpenGL context is gone, since other code has ended EGL; {remedy}") from error
    return renderer


@cache
def _context() -> Any:
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    os.environ.setdefault("PYGLET_HEADLESS", "true")  # pyrender imports its viewer, which would ask for an X server
    with suppress(ImportError):  # its LLVM crashes if it is loaded after that of Mesa's llvmpipe; torch's optimisers load it
        import triton  # noqa: F401
    try:
        import pyrender
        from pyrender.shader_program import ShaderProgramCache

        renderer = pyrender.OffscreenRenderer(1, 1)
    except Exception as error:  # missing libraries and drivers show as ImportError, AttributeError, AssertionError, EGLError ...
        reason = str(error) or type(error).__name__
        remedy = "install libegl1 and libgl1-mesa-dri, or take the face source 'raycast'"
        raise NoOpenGL(f"no offscreen OpenGL here ({reason}); {remedy}") from error
    renderer._renderer._program_cache = ShaderProgramCache(shader_dir=str(Path(__file__).parent / "shaders"))
    return renderer


def _renderer_name() -> str:
    from OpenGL.GL import GL_RENDERER, glGetString

    context()
    return glGetString(GL_RENDERER).decode()
