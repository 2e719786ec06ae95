"""Create the offscreen OpenGL context of the rasteriser and print what renders: a program of its own, for a broken driver may crash it."""

import os

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")

import pyrender
from OpenGL import GL


def main() -> None:
    renderer = pyrender.OffscreenRenderer(16, 16)
    print(*(GL.glGetString(name).decode() for name in (GL.GL_RENDERER, GL.GL_VERSION)), sep=", OpenGL ")
    renderer.delete()


if __name__ == "__main__":
    main()
