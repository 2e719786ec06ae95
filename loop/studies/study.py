"""A study in a folder: it survives the end of a process, and all processes with the same settings share it."""

import json
import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Final

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from luxloop.world.errors import LuxloopError
from luxloop.world.files import shared_folder, turn

STUDY = "study.log"
FINISHED = (TrialState.COMPLETE, TrialState.PRUNED)
PRUNING_AFTER = 8  # trials
_START: Final = b'{"op_code":'  # begins every line


@contextmanager
def study_in(out: Path, digest: str) -> Iterator[optuna.Study]:
    """The study with a digest of settings in a folder; other processes may work on it at the same time.

    Raises LuxloopError if the folder holds another study, another process has locked it, or it cannot be written.
    """
    file = out / STUDY
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    warnings.filterwarnings("ignore", category=optuna.exceptions.ExperimentalWarning)
    try:
        with shared_folder(out, file, partial(_mend, file, digest)):
            with turn(file):
                study = _opened(file, digest)
            yield study
    except OSError as error:
        raise LuxloopError(
            f"{file}: cannot be written ({error.strerror}); check the folder, its permissions and the room left, or give another with --out"
        ) from error


@contextmanager
def keeping(out: Path, what: Callable[[], str]) -> Iterator[None]:
    """Add to an interrupt the message of what a study's folder keeps."""
    try:
        yield
    except KeyboardInterrupt as error:
        raise KeyboardInterrupt(f"{what()} are kept in {out / STUDY}, the same command goes on from there") from error


def finished(study: optuna.Study) -> int:
    """Number of trials that are complete or pruned."""
    return len(study.get_trials(deepcopy=False, states=FINISHED))


def _mend(file: Path, digest: str) -> None:
    """Clean up after a killed process: the journal's lock, an incomplete last line, trials that never end."""
    file.with_name(f"{file.name}.lock").unlink(missing_ok=True)
    content = file.read_bytes()
    last = (content.splitlines(keepends=True) or [b""])[-1]
    if content.startswith(_START) or _START.startswith(content):  # else it is no journal
        try:
            json.loads(last if last.endswith(b"\n") else b"")
        except (ValueError, RecursionError):
            os.truncate(file, len(content) - len(last))
    study = _opened(file, digest)
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        study.tell(trial.number, state=TrialState.FAIL)


def _opened(file: Path, digest: str) -> optuna.Study:
    try:
        storage = JournalStorage(JournalFileBackend(str(file)))
        pruner = optuna.pruners.MedianPruner(n_startup_trials=PRUNING_AFTER)
        study = optuna.create_study(storage=storage, study_name="tune", pruner=pruner, load_if_exists=True)
    except OSError:
        raise
    except Exception as error:  # Optuna raises whatever a damaged journal provokes
        raise LuxloopError(
            f"{file}: is not a study's journal ({str(error) or type(error).__name__}); give another folder with --out"
        ) from error
    if study.user_attrs.setdefault("task", digest) != digest:
        raise LuxloopError(
            f"{file.parent}: holds a study of other settings or of another luxloop; give another folder with --out, or remove it"
        )
    study.set_user_attr("task", digest)
    return study
