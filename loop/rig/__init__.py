"""A lamp and a camera of a laboratory as a plant: what a rig file says, light out, frames in, and which frame shows which light."""
