"""Bodies and road as triangles, and the vehicle that moves over them."""
