"""Lamps as files: descriptions in TOML, archives of matrices, utilisations."""
