"""Many copies of one closed loop at once."""
