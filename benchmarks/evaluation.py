"""The figures of docs/results/evaluation.md: `python benchmarks/evaluation.py [ARGUMENTS]` is `luxloop evaluate [ARGUMENTS]`."""

import sys

from luxloop.loop.commands.cli import main

if __name__ == "__main__":
    sys.exit(main(["evaluate", *sys.argv[1:]]))
