"""From primitives to the utilisation of a headlight's pixels (T 7)."""
