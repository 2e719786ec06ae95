"""Cases of damaged files in a process of its own: `python -m tests.fuzz.worker FIRST LAST EVERY` tries the cases with these numbers.

Each case follows from its number alone. The memory is limited, and a case that takes too long ends the process; a line `case NUMBER KIND`
says before each what is tried, so that whoever started the process knows which case ended it. One in EVERY builds a scenario.
"""

import logging
import random
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from pathlib import Path

from luxloop.world.errors import LONGEST_SENTENCE, LuxloopError
from tests.fuzz.kinds import ALL, BUILT, Kind

MEMORY_BYTES = 4 << 30
LIMIT_S, HANGS_S = 20, 200  # of processor time, and on the clock of a machine that is busy with other things
NAMES = [name for name, kind in ALL.items() for _ in range(kind.share)]


def kind_of(number: int, every: int) -> str:
    return "build" if every and number % every == every - 1 else NAMES[number * 7919 % len(NAMES)]


def attempt(kind: Kind, sound: dict[str, bytes], rng: random.Random, folder: Path) -> str:
    """What is wrong with the outcome, empty where it is a success or a LuxloopError of one sentence."""
    name = rng.choice(sorted(sound))
    file = folder / name
    file.write_bytes(kind.damage(sound[name], rng))
    try:
        kind.read(file)
    except LuxloopError as error:
        if isinstance(error.__cause__, MemoryError):
            return traceback.format_exc()
        return "" if str(error) and max(map(len, error.args)) <= LONGEST_SENTENCE else f"a message of {len(str(error))} characters"
    except Exception:
        return traceback.format_exc()
    return ""


def main() -> None:
    first, last, every = map(int, sys.argv[1:])
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    warnings.simplefilter("ignore")
    logging.disable()
    made: dict[str, dict[str, bytes]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(first, last):
            name = kind_of(number, every)
            kind = BUILT if name == "build" else ALL[name]
            place = Path(folder) / name
            if name not in made:
                place.mkdir()
                made[name] = kind.sound(place)
            print(f"case {number} {name}", flush=True)
            signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
            signal.alarm(HANGS_S)
            if wrong := attempt(kind, made[name], random.Random(number), place):
                print(f"wrong {number} {name}\n{wrong}", flush=True)
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.alarm(0)
    print("done", flush=True)


if __name__ == "__main__":
    main()
