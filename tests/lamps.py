"""The lamp of tests that need fine rows of light but not the many pixels of the thesis' lamp."""

from pathlib import Path

from luxloop.world.headlight.lamp import Lamp, Module
from luxloop.world.lamps import archive
from luxloop.world.lamps.presets import idealised

# The rows of `idealised-332x1024`, which decide how finely a symbol is drawn on the road, and 64 columns, there as wide as a row is long:
# a sixteenth of its pixels and memory.
SMALL_LAMP = str(Path(__file__).parents[1] / "build/tests/idealised-332x64.npz")

Path(SMALL_LAMP).parent.mkdir(parents=True, exist_ok=True)
archive.save(Path(SMALL_LAMP), Lamp("small", (Module("matrix", idealised(332, 64)),)))
