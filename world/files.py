"""Files from users, within a memory budget; files written whole or not at all; output folders under a lock.

A few bytes can declare any size: an array's header, a picture, a lamp, a camera's resolution. One budget limits all of them.
The kernel's locks end with the process, however it ends, and leave no file behind.
"""

import errno
import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from luxloop.world.errors import LuxloopError

BUDGET_BYTES: Final = 3_000_000_000  # enough for a camera of 1920 x 1080 px at 4 samples, and fits on a machine with 8 GB


def afford(what: str, n_bytes: float, remedy: str) -> None:
    """Raises LuxloopError with the remedy if `n_bytes` exceed the memory budget. what: first words of the message."""
    if n_bytes > BUDGET_BYTES:
        needed = min(n_bytes, 1e18) / 1e9  # a declared number may have more digits than a float
        budget = f"more than the budget of {BUDGET_BYTES / 1e9:g} GB"
        raise LuxloopError(f"{what} would take at least {needed:,.3g} GB of memory, {budget}; {remedy}")


PARTS: Final = ".*.[0-9]*.part"  # names of temporary files
BYTES_A_BYTE: Final = 8  # of a file while it is read: its bytes, its text, its numbers


def content(path: Path) -> bytes:
    """All bytes of a regular file. Raises LuxloopError for anything else, and for one beyond the budget."""
    afford(f"{path}: reading it", BYTES_A_BYTE * regular(path).stat().st_size, "cut it down to the part that is needed")
    with reading(path):
        return path.read_bytes()


def regular(path: Path) -> Path:
    """The path of a regular file. Raises LuxloopError for anything else: devices and pipes may never end."""
    with reading(path):
        if not os.path.isfile(path):
            path.stat()  # raises for what is not there
            raise OSError(errno.EINVAL, "it is a folder" if os.path.isdir(path) else "it is no regular file")
    return path


@contextmanager
def reading(path: Path, otherwise: str = "cannot be read", remedy: str = "check the path") -> Iterator[None]:
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
    """All files of a folder, sorted by name, or the file itself; none if the path does not exist."""
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


def atomic_write(path: Path, content: str | bytes) -> None:
    """Write text, as UTF-8, or bytes into a file, as `whole`."""
    with whole(path) as part:
        part.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def writing(place: Path, remedy: str = "give another folder with --out") -> Iterator[None]:
    """Turn an OSError of a block into `place: cannot be written (reason); remedy`."""
    try:
        yield
    except OSError as error:
        raise LuxloopError(f"{place}: cannot be written ({error.strerror or error}); {remedy}") from error


def link(source: Path, target: Path) -> None:
    """Link a file under a second name, or copy it where the file system has no links. Raises OSError if both fail."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def part_of(path: Path) -> Path:
    """Path of the temporary file that later replaces `path`."""
    return path.with_name(f".{path.name}.{os.getpid()}.part")


@contextmanager
def output_folder(folder: Path) -> Iterator[None]:
    """A folder that only this process writes into; created if missing, and removed again if it was created and stays empty.

    Half-written files of writers that were killed are removed. Raises LuxloopError where another process writes into it, or it
    cannot be made.
    """
    with _open_folder(folder) as descriptor:
        if not _lock(descriptor, fcntl.LOCK_EX):
            raise _in_use(folder)
        for part in folder.glob(PARTS):
            part.unlink(missing_ok=True)
        yield


@contextmanager
def shared_folder(folder: Path, journal: Path, mend: Callable[[], None]) -> Iterator[None]:
    """A folder that several processes write into, taking turns at its journal.

    mend: called if no other process works in the folder, to close trials that the journal still lists as running. Raises LuxloopError where
    another process has locked the folder, or it cannot be made.
    """
    with _open_folder(folder) as descriptor:
        if not _lock(descriptor, fcntl.LOCK_SH) and not journal.exists():  # before a journal is created in a foreign folder
            raise _in_use(folder)
        fcntl.flock(descriptor, fcntl.LOCK_UN)  # waiting processes do not count as working
        with lock_file(journal):
            if _lock(descriptor, fcntl.LOCK_EX):
                mend()
            if not _lock(descriptor, fcntl.LOCK_SH):
                raise _in_use(folder)
        yield


@contextmanager
def lock_file(file: Path) -> Iterator[None]:
    """Lock a block to one process at a time; creates the lock file if missing. Raises OSError if that fails."""
    descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


@contextmanager
def _open_folder(folder: Path) -> Iterator[int]:
    with writing(folder):
        new = [each for each in (folder, *folder.parents) if not each.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY)
    try:
        yield descriptor
    finally:
        with suppress(OSError):  # not empty
            for each in new:
                each.rmdir()
        os.close(descriptor)


def _lock(descriptor: int, how: int) -> bool:
    try:
        fcntl.flock(descriptor, how | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _in_use(folder: Path) -> LuxloopError:
    return LuxloopError(f"{folder}: another process writes into it; wait until that ends, or give another folder with --out")


def installed_version(package: str = "luxloop") -> str:
    """The version of an installed package."""
    from importlib import metadata

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"
