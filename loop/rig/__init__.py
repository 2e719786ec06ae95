"""A real lamp and camera as a plant: the rig file, light, frames, and the rule that assigns a frame to its light."""
