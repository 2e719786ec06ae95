"""Reflection of surfaces: BRDF, named materials, spots."""
