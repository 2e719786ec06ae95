"""Draw the shipped raw utilisations: `python draw_utilisations.py [FOLDER]`, by default into the current folder.

"curtain" is a greeting for two modules of 64 x 256 pixels, 25 frames at 10 Hz: a curtain of light opens from the middle, chevrons run
outward, and what is left is a soft field of light. A frame is a grey picture with a value a pixel, white is full utilisation.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

ROWS, COLUMNS, FRAMES = 64, 256, 25
OPENING, RUNNING = 8, 9  # frames: the curtain opens, chevrons run; the rest fades
PITCH, STEP = 32, 6  # columns from chevron to chevron, and those that they run a frame
LIT, BETWEEN = 1.0, 0.15


def frame(k: int) -> np.ndarray:
    """Utilisations `[ROWS, COLUMNS]` of the k-th frame."""
    row, column = np.mgrid[:ROWS, :COLUMNS] + 0.5
    aside, off_middle = abs(column - COLUMNS / 2), abs(row - ROWS / 2)
    phase = (aside + off_middle - STEP * k) % PITCH / PITCH
    chevrons = np.where(phase < 0.5, LIT, BETWEEN)
    edge = COLUMNS / 2 * min((k + 1) / OPENING, 1.0)
    curtain = np.clip(edge - aside, 0, 1)
    field = 0.6 * np.cos(np.pi * aside / COLUMNS) ** 2 * np.cos(np.pi * off_middle / ROWS) ** 2
    fading = np.clip((k - OPENING - RUNNING) / (FRAMES - 1 - OPENING - RUNNING), 0, 1)
    return curtain * ((1 - fading) * chevrons + fading * field)


def draw(folder: Path) -> None:
    """Write all frames into a folder of their own."""
    (folder / "curtain").mkdir(parents=True, exist_ok=True)
    for k in range(FRAMES):
        cv2.imwrite(str(folder / "curtain" / f"{k:02d}.png"), np.round(255 * frame(k)).astype(np.uint8), [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
