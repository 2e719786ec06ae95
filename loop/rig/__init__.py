"""A real lamp and camera as a plant: rig file, light, frames, and the rule that assigns a frame to its light."""
