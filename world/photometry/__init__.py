"""Photometric files and what is made of them: IES LM-63 and EULUMDAT, distributions on the sphere, light textures (T 2.3, 5.2)."""

from luxloop.world.photometry.distribution import Distribution, sample
from luxloop.world.photometry.eulumdat import write as write_eulumdat
from luxloop.world.photometry.files import read_all, read_photometry
from luxloop.world.photometry.lm63 import write
from luxloop.world.photometry.record import Photometry
from luxloop.world.photometry.texture import light_texture, rmse

__all__ = ["Distribution", "Photometry", "light_texture", "read_all", "read_photometry", "rmse", "sample", "write", "write_eulumdat"]
