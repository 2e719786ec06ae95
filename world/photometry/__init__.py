"""Photometric files and what is made of them: IES LM-63 and EULUMDAT, distributions on the sphere, light textures (T 2.3, 5.2)."""
