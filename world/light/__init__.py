"""From the utilisation of a lamp to the luminance of a scene."""
