"""Where face ids come from: OpenGL if there is any, else rays."""

import warnings
from functools import cached_property
from typing import Literal, Protocol

from torch import Tensor

from luxloop.world.rendering.rasterise import NoOpenGL, Rasteriser
from luxloop.world.rendering.raycast import RayCaster
from luxloop.world.scene.triangles import Triangles
from luxloop.world.view import View


class FaceSource(Protocol):
    """Tells which triangle each pixel of a view sees; `name` says by what means."""

    @property
    def name(self) -> str: ...

    def face_ids(self, triangles: Triangles, view: View) -> Tensor:
        """Id of the nearest face through each pixel's centre, `[height, width]` int64, -1 where there is none."""
        ...


class FirstFound:
    """OpenGL if there is any, else rays, which is found out when something is first looked at: a context takes half a second to make."""

    @cached_property
    def found(self) -> FaceSource:
        """What it is. Warns where there is no OpenGL."""
        return face_source("auto")

    @property
    def name(self) -> str:
        return self.found.name

    def face_ids(self, triangles: Triangles, view: View) -> Tensor:
        """As of what it is."""
        return self.found.face_ids(triangles, view)


def face_source(name: Literal["auto", "opengl", "raycast"] = "auto") -> FaceSource:
    """The face source of that name; "auto" takes OpenGL and falls back to rays with a warning. Raises NoOpenGL for "opengl"."""
    if name == "raycast":
        return RayCaster()
    try:
        return Rasteriser()
    except NoOpenGL as error:
        if name == "opengl":
            raise
        warnings.warn(f"rendering by ray casting, which is slower: {error}", stacklevel=2)
        return RayCaster()
