"""Road surfaces: shapes, roughness, scans, and user-defined roads."""
