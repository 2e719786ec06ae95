"""Files from users, read with a one-sentence error if that fails, and files that are written whole or not at all."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from luxloop.world.budget import afford
from luxloop.world.errors import LuxloopError

PARTS: Final = ".*.[0-9]*.part"  # pattern of the names of half-written files
BYTES_A_BYTE: Final = 8  # of a file while it is read: its bytes, its text, its numbers


def content(path: Path) -> bytes:
    """All bytes of a regular file. Raises OSError for anything else, and LuxloopError for one beyond the budget."""
    afford(f"{path}: reading it", BYTES_A_BYTE * regular(path).stat().st_size, "cut it down to the part that is needed")
    return path.read_bytes()


def regular(path: Path) -> Path:
    """The path of a regular file. Raises OSError for anything else: devices and pipes may never end."""
    if not os.path.isfile(path):
        path.stat()  # raises for what is not there
        raise OSError(errno.EINVAL, "it is a folder" if os.path.isdir(path) else "it is no regular file")
    return path


@contextmanager
def reading(path: Path, otherwise: str, remedy: str) -> Iterator[None]:
    """Turn any exception of a reader of a damaged or foreign file into `path: otherwise (reason); remedy`."""
    try:
        yield
    except LuxloopError:
        raise
    except Exception as error:  # readers raise whatever their formats provoke, OSError without a number as well
        if isinstance(error, OSError) and error.strerror:
            raise LuxloopError(f"{path}: cannot be read ({error.strerror}); check the path") from error
        raise LuxloopError(f"{path}: {otherwise} ({str(error).strip() or type(error).__name__}); {remedy}") from error


def files_at(path: Path) -> list[Path]:
    """All files of a folder in the order of their names, or the file itself; none where there is nothing."""
    return [file for file in (sorted(path.iterdir()) if os.path.isdir(path) else [path]) if os.path.isfile(file)]


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A temporary file that replaces `path` at the end; on failure nothing is left behind.

    Raises: LuxloopError where it cannot be written.
    """
    if os.path.isdir(path):
        raise LuxloopError(f"{path}: cannot be written, because it is a folder; name a file in it")
    part = part_of(path)
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else error  # Arrow's errors have texts of their own
        raise LuxloopError(f"{path}: cannot be written ({reason}); check the folder, its permissions and the room left") from error
    finally:
        if os.path.lexists(part):  # no folder, no part, and no second error
            part.unlink()


def link(source: Path, target: Path) -> None:
    """A second name of a file, which takes no room, or a copy where there can be none. Raises OSError where neither can be."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def part_of(path: Path) -> Path:
    """Where a file is written until it is whole."""
    return path.with_name(f".{path.name}.{os.getpid()}.part")
