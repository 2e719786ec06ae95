"""Lamps: shipped ones, descriptions in TOML, archives of matrices; their beams, fitted to patterns; utilisations as files."""
