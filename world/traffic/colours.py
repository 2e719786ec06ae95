"""Colours of surfaces, for pictures that people look at; cameras and lamps know luminance only."""

import zlib
from typing import Final

from luxloop.world.headlight.matrix import LUMINANCE
from luxloop.world.materials.library import MaterialName
from luxloop.world.scene.body import Part

Rgb = tuple[float, float, float]  # linear sRGB

OF_MATERIALS: Final[dict[MaterialName, Rgb]] = {
    "skin": (0.6, 0.38, 0.27),
    "hair": (0.3, 0.2, 0.13),
    "fur": (0.4, 0.28, 0.17),
    "leaves": (0.16, 0.3, 0.07),
    "bark": (0.34, 0.26, 0.19),
    "tail_lamp": (1.0, 0.02, 0.01),
    "lane_paint": (1.0, 0.99, 0.95),
}
WHITE, RED, BLUE, LIME = (1.0, 1.0, 1.0), (0.7, 0.03, 0.03), (0.02, 0.1, 0.5), (0.55, 0.9, 0.04)
OF_PARTS: Final[dict[str, Rgb]] = {"tail_lamps": RED, "tail_lamp": RED, "rear_lamp": RED, "reflector": RED}
CLOTHES: Final = ((1, 1, 1), (0.2, 0.3, 0.6), (0.55, 0.2, 0.16), (0.25, 0.4, 0.3), (0.55, 0.45, 0.32), (0.5, 0.5, 0.58))
PAINTS: Final = ((1, 1, 1), (1, 1, 1), (0.15, 0.25, 0.6), (0.6, 0.07, 0.05), (0.7, 0.72, 0.75), (0.16, 0.3, 0.2))
DARK: Final = 0.2  # albedo below which sheeting of a sign is coloured


def colour(owner: str, part: Part, banded: bool) -> Rgb:
    """Colour of a part at luminance 1. owner: name of its object, which chooses among clothes and paints. banded: it wears a vest."""
    if part.name in OF_PARTS:
        return _at_luminance_1(OF_PARTS[part.name])
    if part.name in ("border", "face") and part.albedo < DARK:
        return _at_luminance_1(RED if part.name == "border" else BLUE)
    if part.name == "jacket" and banded:
        return _at_luminance_1(LIME)
    palette = {"cloth": CLOTHES, "car_paint": PAINTS}.get(part.material, (OF_MATERIALS.get(part.material, WHITE),))
    return _at_luminance_1(palette[zlib.crc32(f"{owner} {part.name}".encode()) % len(palette)])


def _at_luminance_1(rgb: Rgb) -> Rgb:
    luminance = sum(weight * value for weight, value in zip(LUMINANCE, rgb, strict=True))
    red, green, blue = rgb
    return red / luminance, green / luminance, blue / luminance


GRASS: Final = _at_luminance_1((0.2, 0.26, 0.1))
TAIL_LAMP: Final = _at_luminance_1(RED)
SKY: Final = _at_luminance_1((0.6, 0.75, 1.0))
