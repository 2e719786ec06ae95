"""How a symbol is drawn, and what the camera's frames say of it."""
