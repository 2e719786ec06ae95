"""From triangles to a G-buffer: OpenGL or rays."""
