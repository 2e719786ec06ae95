"""A symbol's closed loop as an environment to learn in, for Gymnasium."""
