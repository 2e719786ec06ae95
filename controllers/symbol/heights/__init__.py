"""Controllers that compensate for the heights of the road and the motion of the body."""
