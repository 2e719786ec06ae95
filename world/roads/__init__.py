"""Road surfaces: shapes, noise, scans, and those of the user's own."""
