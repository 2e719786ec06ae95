"""Where the labels of a recording lie."""

from pathlib import Path
from typing import Final

from luxloop.loop.simulation.frames import FOLDER as FRAMES
from luxloop.loop.simulation.frames import image_file, light_file

FOLDER: Final = "labels"
COCO, IMAGES = f"{FOLDER}/coco.json", f"{FOLDER}/images.json"
IMAGE_2, LABEL_2, CALIB = (f"{FOLDER}/{name}" for name in ("image_2", "label_2", "calib"))
PATTERNS: Final = {
    FOLDER: ("coco.json", "images.json", "instances_*.png", "parts_*.png", "depth_*.npz", "lux_*.npz"),
    IMAGE_2: ("*.png",),
    LABEL_2: ("*.txt",),
    CALIB: ("*.txt",),
}


def frame_name(number: int) -> str:
    """The frame of an exposure, from the recording's folder on."""
    return f"{FRAMES}/{image_file(Path(), number).name}"


def light_name(number: int) -> str:
    """A light, from the recording's folder on."""
    return f"{FRAMES}/{light_file(Path(), number).name}"


def mask_name(kind: str, number: int) -> str:
    """A mask of the instances or parts of an exposure's frame, from the recording's folder on."""
    return f"{FOLDER}/{kind}_{number:08d}.png"


def values_name(kind: str, number: int) -> str:
    """Values at the pixels of an exposure's frame, depth or lux, from the recording's folder on."""
    return f"{FOLDER}/{kind}_{number:08d}.npz"


def remove(directory: Path) -> None:
    """Remove the labels of a recording, if there are any, and nothing else. Raises OSError where that cannot be."""
    for name, patterns in reversed(PATTERNS.items()):
        folder = directory / name
        if folder.is_symlink():
            folder.unlink()
        for pattern in patterns:
            for file in folder.glob(pattern):
                file.unlink()
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
