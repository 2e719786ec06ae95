"""A symbol's closed loop as a reinforcement learning environment of Gymnasium."""
