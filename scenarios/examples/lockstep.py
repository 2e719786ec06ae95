"""A controller in a process of its own: `python lockstep.py ADDRESS [STEPS]`, the address that `luxloop studio` prints for editing.

It holds the brightness of the near road, as the camera measures it, by raw utilisations of all modules, step by step:

    luxloop studio flat --no-open --set functions={} checks={} lighting.base.beam=off headlight.model=ssl-hd
"""

import sys

import numpy as np

import luxloop

WANTED = 0.25  # mean digital number of the near road, as a share of the largest
GAIN = 0.7  # share of the error, in logarithms, that a step takes away
FIRST = 0.05  # utilisation to begin with


def near(frame: np.ndarray) -> np.ndarray:
    """The part of a frame that sees the road just before the car."""
    rows, columns = frame.shape
    return frame[3 * rows // 4 :, columns // 4 : 3 * columns // 4]


def main(address: str, steps: int = 8) -> None:
    """Close the loop."""
    with luxloop.connect(address, views=("frames",)) as client:
        client.take_pen()
        most = 2 ** client.facts["camera"]["bits"] - 1
        share = FIRST
        for _ in range(steps):
            for module in client.facts["modules"]:
                client.show(module["name"], np.full((module["pixel_rows"], module["pixel_cols"]), share))
            state = client.step()
            seen = max(near(state.frames[0]).mean() / most, 1 / most)
            print(f"step {state.step}: {share:.3f} of full light, the road at {seen:.3f}", flush=True)
            share = float(np.clip(share * (WANTED / seen) ** GAIN, 0.01, 1.0))


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:3]))
