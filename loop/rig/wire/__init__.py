"""Bytes on the network between a loop and a rig: light, camera frames, sensor samples. Without torch."""
