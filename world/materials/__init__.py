"""What surfaces reflect: BRDF, materials by name, spots."""
