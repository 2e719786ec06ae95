"""Pictures of headlights and of photometric files."""
