"""Files that appear whole or not at all, and what NumPy says of files that are damaged or something else."""

import os
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from world.errors import LuxloopError

# What reading a .npy or .npz raises beside OSError.
UNREADABLE: Final = (
    *(zipfile.BadZipFile, zlib.error, ValueError, KeyError, EOFError, NotImplementedError, RuntimeError, OverflowError),
    *(SyntaxError, TypeError),
)


def files_at(path: Path) -> list[Path]:
    """All files of a folder in the order of their names, or the file itself; none where there is nothing."""
    return [file for file in (sorted(path.iterdir()) if path.is_dir() else [path]) if file.is_file()]


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A file to write in place of `path`, which it becomes at the end; where anything fails, nothing is left behind.

    Raises: LuxloopError where it cannot be written.
    """
    if path.is_dir():
        raise LuxloopError(f"{path}: cannot be written, for it is a folder; name a file in it")
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        raise LuxloopError(f"{path}: cannot be written ({error.strerror}); check the folder and its permissions") from error
    finally:
        if os.path.lexists(part):  # no folder, no part, and no second error
            part.unlink()
