"""Many independent jobs over all cores."""
