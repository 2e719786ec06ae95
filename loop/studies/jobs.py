"""Job runner of evaluations, campaigns and data sets: independent jobs over all cores, each stored as soon as it is done.

An interrupted run resumes, failures are collected, and a job whose parameters or code changed runs again. An executor decides where jobs
run: in processes of this machine, or on workers of a Dask scheduler; it yields results as jobs finish.
"""

import hashlib
import json
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol, TypeVar

from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky import process_executor

from luxloop.loop.recording.sources import digest_of_code
from luxloop.loop.report import terminal as tables
from luxloop.world.errors import LuxloopError
from luxloop.world.files import writing
from luxloop.world.validation import parsed_json

Task = TypeVar("Task")
Result = TypeVar("Result")
CONNECTING_S = 10
WATCHING_S = 0.5  # interval at which a worker checks whether its parent process still runs


class WorkersLostError(LuxloopError):
    """The workers were lost; results already yielded stay valid."""


class Executor(Protocol):
    """Executor that calls a function with each task and yields results in order of completion. Raises WorkersLostError.

    workers: number of parallel tasks.
    """

    @property
    def workers(self) -> int: ...

    def __call__(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]: ...


def local(processes: int | None = None) -> Executor:
    """Executor on processes of this machine, one thread each, by default one per core; a single one is this process."""
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


ALL_CORES = local()


def _begin() -> None:
    """Set up a worker process."""
    for each in (signal.SIGINT, signal.SIGTERM):  # terminals and services send them to workers as well; the parent ends its workers
        signal.signal(each, signal.SIG_IGN)
    threading.Thread(target=_end_after, args=(os.getppid(),), daemon=True).start()
    process_executor._USE_PSUTIL = False  # joblib would end workers that keep 300 MB between tasks


def _end_after(parent: int) -> None:
    """End this worker once its parent process is gone."""
    while os.getppid() == parent:
        time.sleep(WATCHING_S)
    os._exit(1)


def dask(scheduler: str) -> Executor:
    """Executor on the workers of a Dask scheduler, such as tcp://host:8786; a task whose worker is lost goes to another.

    Raises LuxloopError if Dask is missing, the scheduler does not answer, or a worker has another version of luxloop.
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
        """Client of the scheduler. Raises LuxloopError as `dask`."""
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


Values = Mapping[str, Any]  # JSON values by name
NAMED = 4  # most jobs named in a message
_START = b'{"id": '  # begins every line


@dataclass(frozen=True)
class Job:
    """A job: keyword arguments of a call.

    key: readable name for tables and messages. place: further arguments that say where the call puts files and do not decide its result.
    """

    key: str
    parameters: Values
    place: Values = field(default_factory=dict)


@dataclass(frozen=True)
class Results:
    """Results of a run of jobs: key, parameters and result of each successful job in the order of the jobs; reasons of failures by key."""

    rows: list[dict[str, Any]]
    failures: dict[str, str]

    def write(self, file: Path) -> None:
        """Write the rows atomically as Parquet. Raises LuxloopError on failure."""
        import pyarrow as pa  # imported here, since workers do not need it and start faster

        from luxloop.loop.recording.manifest import write_table

        try:
            with writing(file):
                file.parent.mkdir(parents=True, exist_ok=True)
                write_table(file, pa.Table.from_pylist(self.rows))
        except pa.ArrowException as error:
            raise LuxloopError(f"{file}: results make no table ({error}); remove the file of results, or give another folder") from error


def run(  # noqa: PLR0913 (each value stands by itself)
    function: Callable[..., Any],
    jobs: Sequence[Job],
    file: Path,
    *,
    version: str,
    executor: Executor = ALL_CORES,
    title: str = "jobs",
    is_there: Callable[[Job], bool] = lambda job: True,
    kind: Callable[[Values], str | None] | None = None,
) -> Results:
    """Run the jobs without a result in the file; returns the results of all jobs.

    function: importable from a module's top level; takes the parameters of a job and returns a JSON value. file: JSON lines, one per
    result; lines are only added, and results of other functions, parameters and versions stay. version: what decides a result besides its
    parameters, such as `digest_of(...)`. executor: by default a process per core. is_there: whether files that a call made still exist; if
    not, the job runs again. kind: of a job's parameters; jobs of one kind may run as a batch, jobs of kind None run alone. With `kind` the
    function takes a sequence of parameters, and returns a result or an exception for each. Failed jobs run again the next time.

    Raises KeyboardInterrupt with what is stored; LuxloopError if workers are lost, or the file is of another kind or cannot be written.
    """
    many = function if kind else partial(_one_by_one, function)
    pairs = [(identity_of(function, job.parameters, version), job) for job in jobs]
    read = _read(file)
    done = {identity: read[identity] for identity, job in pairs if identity in read and is_there(job)}
    left = {identity: job for identity, job in pairs if identity not in done}
    total, failures = len(dict(pairs)), dict[str, str]()
    try:
        with tables.progress(title, total, total - len(left)) as advance:
            tasks = [(identity, {**job.parameters, **job.place}) for identity, job in left.items()]
            kinds = [kind and kind(parameters) for _, parameters in tasks]
            found = bundles(kinds, executor.workers if any(kinds) else 1)
            if together := [len(each) for each in found if len(each) > 1]:
                tables.say(f"{sum(together)} of {len(tasks)} {title} in batches of up to {max(together)}", stderr=True)
            for ended in executor(partial(_call, many), [[tasks[k] for k in places] for places in found]):
                for identity, result, error in ended:
                    if error:
                        failures[identity] = error
                    else:
                        _append(file, f'{{"id": "{identity}", "key": {json.dumps(left[identity].key)}, "result": {result}}}')
                        done[identity] = json.loads(result)
                    advance()
    except (KeyboardInterrupt, WorkersLostError) as error:
        kept = f"{len(done)} of {total} {title} are kept in {file}, the same command goes on from there"
        if isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt(kept) from error
        lost = [job.key for identity, job in left.items() if identity not in done and identity not in failures]
        raise LuxloopError(f"{error}: {kept}; the first that are not done: {'; '.join(lost[:NAMED])}") from error
    return Results(
        [{"key": job.key, **job.parameters, **done[identity]} for identity, job in pairs if identity in done],
        {job.key: failures[identity] for identity, job in pairs if identity in failures},
    )


def digest_of(*modules: ModuleType) -> str:
    """Digest of modules' code, for results that depend on it."""
    return hashlib.sha256(b"".join(Path(str(module.__file__)).read_bytes() for module in modules)).hexdigest()


def identity_of(function: Callable[..., Values], parameters: Values, version: str) -> str:
    """Digest of everything that decides a job's result."""
    decisive = [function.__module__, function.__qualname__, version, parameters]
    return hashlib.sha256(json.dumps(decisive, sort_keys=True).encode()).hexdigest()[:32]


Many = Callable[[Sequence[Values]], Sequence[Values | Exception]]


def _call(many: Many, tasks: Sequence[tuple[str, Values]]) -> list[tuple[str, str, str]]:
    """Identity, result as JSON, and reason of failure of each job; one of the latter two is empty."""
    found = []
    for (identity, _), result in zip(tasks, many([parameters for _, parameters in tasks]), strict=True):
        try:
            found.append((identity, "", reason(result)) if isinstance(result, Exception) else (identity, json.dumps(dict(result)), ""))
        except Exception as error:
            found.append((identity, "", reason(error)))
    return found


def _one_by_one(function: Callable[..., Values], parameters: Sequence[Values]) -> list[Values | Exception]:
    found: list[Values | Exception] = []
    for each in parameters:
        try:
            found.append(function(**each))
        except Exception as error:
            found.append(error)
    return found


def reason(error: Exception) -> str:
    """Reason of a failure: luxloop's own sentence, or the exception and its place in the code."""
    if isinstance(error, LuxloopError):
        return "; ".join(map(str, error.args))
    where = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(where.filename).name}, line {where.lineno})"


def _read(file: Path) -> dict[str, dict[str, Any]]:
    """Results by identity. An incomplete last line, from a kill or a full disk, is removed; its job runs again."""
    try:
        content = file.read_bytes() if file.exists() else b""
        *lines, last = content.splitlines(keepends=True) or [b""]
        results = dict(map(_entry, lines))
        try:
            identity, result = _entry(last)
            results[identity] = result
        except (ValueError, KeyError, TypeError):
            if not (results or last.startswith(_START) or _START.startswith(last)):
                raise
            if last:
                os.truncate(file, len(content) - len(last))
        return results
    except (ValueError, KeyError, TypeError) as error:
        raise LuxloopError(f"{file}: holds something other than job results; remove it or give another folder") from error
    except OSError as error:
        raise LuxloopError(f"{file}: cannot be read ({error.strerror}); check its permissions") from error


def _entry(line: bytes) -> tuple[str, dict[str, Any]]:
    """Identity and result of a complete line. Raises ValueError, KeyError or TypeError for other lines."""
    if not line.endswith(b"\n"):
        raise ValueError("its last line has no end")
    entry = parsed_json(line)
    if not isinstance(entry["result"], dict):
        raise TypeError("a result is no table")
    return entry["id"], entry["result"]


def _append(file: Path, line: str) -> None:
    with writing(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("ab") as stream:
            stream.write(line.encode() + b"\n")


MOST = 16  # jobs in a batch; larger batches are no faster and store results later


def bundles(kinds: Sequence[str | None], workers: int) -> list[list[int]]:
    """Indices of jobs that run as a batch: jobs of one kind, in as many batches as keep all workers busy. Jobs of kind None run alone."""
    alike: dict[str, list[int]] = {}
    found = []
    for place, kind in enumerate(kinds):
        if kind is None:
            found.append([place])
        else:
            alike.setdefault(kind, []).append(place)
    for places in alike.values():
        size = min(-(-len(places) // workers), MOST)
        found += [places[k : k + size] for k in range(0, len(places), size)]
    return sorted(found)
