"""Road users and roadside objects as random meshes."""
