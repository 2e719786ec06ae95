"""Light that follows what the camera measures of places and materials."""
