"""Network formats between a loop and a rig: light, camera frames, sensor samples."""
