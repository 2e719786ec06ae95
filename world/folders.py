"""Output folders of commands, locked by one process or shared by several.

The kernel's locks end with the process, however it ends, and leave no file behind.
"""

import fcntl
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from luxloop.world.errors import LuxloopError
from luxloop.world.files import PARTS


@contextmanager
def output_folder(folder: Path) -> Iterator[None]:
    """A folder that only this process writes into; created if missing, and removed again if it was created and stays empty.

    Half-written files of writers that were killed are removed. Raises LuxloopError where another process writes into it, or it
    cannot be made.
    """
    with _opened(folder) as descriptor:
        if not _locked(descriptor, fcntl.LOCK_EX):
            raise _in_use(folder)
        for part in folder.glob(PARTS):
            part.unlink(missing_ok=True)
        yield


@contextmanager
def shared_folder(folder: Path, journal: Path, mend: Callable[[], None]) -> Iterator[None]:
    """A folder that several processes write into, which take turns with the journal in it.

    mend: called if no other process works in the folder: trials that the journal lists as running were then killed. Raises LuxloopError
    where another process has locked the folder, or it cannot be made.
    """
    with _opened(folder) as descriptor:
        if not _locked(descriptor, fcntl.LOCK_SH) and not journal.exists():  # before a journal is created in a foreign folder
            raise _in_use(folder)
        fcntl.flock(descriptor, fcntl.LOCK_UN)  # waiting processes do not count as working
        with turn(journal):
            if _locked(descriptor, fcntl.LOCK_EX):
                mend()
            if not _locked(descriptor, fcntl.LOCK_SH):
                raise _in_use(folder)
        yield


@contextmanager
def turn(file: Path) -> Iterator[None]:
    """A block that one process at a time enters; the lock file is created if missing. Raises OSError if that fails."""
    descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


@contextmanager
def _opened(folder: Path) -> Iterator[int]:
    try:
        new = [each for each in (folder, *folder.parents) if not each.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise LuxloopError(f"{folder}: cannot be written ({error.strerror}); give another folder with --out") from error
    try:
        yield descriptor
    finally:
        with suppress(OSError):  # not empty
            for each in new:
                each.rmdir()
        os.close(descriptor)


def _locked(descriptor: int, how: int) -> bool:
    try:
        fcntl.flock(descriptor, how | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _in_use(folder: Path) -> LuxloopError:
    return LuxloopError(f"{folder}: another process writes into it; wait until that ends, or give another folder with --out")
