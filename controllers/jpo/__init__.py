"""Joint Pixel Optimisation (T 8)."""
