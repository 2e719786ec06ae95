"""Reinforcement learning environments of Gymnasium around a symbol's closed loop."""
