"""Road users and what stands beside roads, as meshes made from a seed."""
