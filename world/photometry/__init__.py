"""Photometric files and what is made of them: IES LM-63 and EULUMDAT, distributions on the sphere, light textures (T 2.3, 5.2)."""

from world.photometry.distribution import Distribution, sample
from world.photometry.eulumdat import write as write_eulumdat
from world.photometry.files import read, read_all
from world.photometry.lm63 import write
from world.photometry.record import Photometry
from world.photometry.texture import light_texture, rmse

__all__ = ["Distribution", "Photometry", "light_texture", "read", "read_all", "rmse", "sample", "write", "write_eulumdat"]
