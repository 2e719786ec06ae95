"""Executors of jobs: processes of this machine, or workers of a Dask scheduler. They yield results as jobs finish."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Final, Protocol, TypeVar

from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky import process_executor

from luxloop.loop.recording.sources import digest_of_code
from luxloop.world.errors import LuxloopError

Task = TypeVar("Task")
Result = TypeVar("Result")
CONNECTING_S = 10
WATCHING_S = 0.5  # interval at which a worker checks whether its parent process still runs


class WorkersLostError(LuxloopError):
    """The workers died; results already yielded stay valid."""


class Executor(Protocol):
    """Calls a function with each task and yields results in order of completion. Raises WorkersLostError. workers: tasks at once."""

    @property
    def workers(self) -> int: ...

    def __call__(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]: ...


def local(processes: int | None = None) -> Executor:
    """An executor on processes of this machine, each with one thread, by default one per core; a single one is this process."""
    return _Local(processes or os.cpu_count() or 1)


@dataclass(frozen=True)
class _Local:
    workers: int

    def __call__(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        workers = min(self.workers, len(tasks))
        if workers <= 1:
            yield from map(function, tasks)
            return
        with parallel_config("loky", inner_max_num_threads=1, initializer=_begin):
            parallel = Parallel(workers, return_as="generator_unordered", batch_size=1)
        try:
            yield from parallel(delayed(function)(task) for task in tasks)
        except BrokenProcessPool as error:
            raise WorkersLostError("a worker process was killed, probably for lack of memory; use fewer processes") from error


ALL_CORES: Final = local()


def _begin() -> None:
    """Set up a worker before its first task."""
    for each in (signal.SIGINT, signal.SIGTERM):  # also sent to workers by terminals and services; the parent process ends its workers
        signal.signal(each, signal.SIG_IGN)
    threading.Thread(target=_end_after, args=(os.getppid(),), daemon=True).start()
    process_executor._USE_PSUTIL = False  # otherwise a worker that keeps 300 MB between tasks, as simulations do, is ended as leaking


def _end_after(parent: int) -> None:
    """End this worker after its parent process was killed and could not end it."""
    while os.getppid() == parent:
        time.sleep(WATCHING_S)
    os._exit(1)


def dask(scheduler: str) -> Executor:
    """An executor on the workers of a scheduler, such as tcp://host:8786; a task whose worker is lost goes to another.

    Raises LuxloopError if Dask is not installed, the scheduler does not answer, or a worker has another version of luxloop.
    """
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise LuxloopError("--scheduler: needs Dask, which is not installed; get it with pip install 'luxloop[dask]'") from error
    return _Dask(scheduler)


@dataclass(frozen=True)
class _Dask:
    scheduler: str

    @property
    def workers(self) -> int:
        with self._connect() as client:
            return len(client.scheduler_info(n_workers=-1)["workers"])

    def __call__(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        import distributed

        with self._connect() as client:
            try:
                for future in distributed.as_completed(client.map(function, tasks, pure=False), loop=client.loop):
                    yield future.result()
                    future.release()
            except distributed.KilledWorker as error:
                raise WorkersLostError(f"{self._where}: a job has killed several workers, probably for lack of memory") from error
            except (OSError, distributed.client.FutureCancelledError, distributed.client.FuturesCancelledError) as error:
                raise WorkersLostError(f"{self._where}: was lost") from error

    @property
    def _where(self) -> str:
        return f"--scheduler {self.scheduler}"

    def _connect(self) -> Any:
        """A client. Raises LuxloopError as `dask`."""
        import distributed

        where = self._where
        try:
            client = distributed.Client(self.scheduler, timeout=CONNECTING_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise LuxloopError(f"{where}: no answer; start `dask scheduler`, and give the address that it prints") from error
        try:
            client.wait_for_workers(1, timeout=CONNECTING_S)
            digests = client.run(digest_of_code)
        except TimeoutError as error:
            raise LuxloopError(f"{where}: has no workers; start `dask worker {self.scheduler} --nthreads 1`") from error
        except ImportError as error:
            raise LuxloopError(f"{where}: a worker has no luxloop ({error}); install this one there") from error
        if others := [worker for worker, digest in digests.items() if digest != digest_of_code()]:
            raise LuxloopError(f"{where}: {', '.join(others)} has another luxloop; install this one there")
        return client
