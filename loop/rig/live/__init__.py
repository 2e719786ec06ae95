"""A real lamp's beam, digitised live as the light of a module of the simulated world (T 4.3)."""
