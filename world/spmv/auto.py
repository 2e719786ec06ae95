"""Which format is fastest for this lamp on this machine: measured once, then remembered (T 6.1's proposal)."""

import hashlib
import json
import os
import platform
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
import torch
from torch import Tensor

from world.spmv.csr import Csr
from world.spmv.formats import FORMATS, build
from world.spmv.graph import CapturedProduct
from world.spmv.protocol import SparseFormat, lit_rows

ROUNDS = 100  # of measurements at most
ENOUGH_S = 0.8  # of measuring; the round that is on is finished
FIRST_SLACK, LAST_SLACK = 2.0, 0.3  # by which a format may be slower than the best and still run on, after one round and after many
LARGEST = 3  # times the bytes of CSR: what a format may store to be considered
LONG_ROWS = 6  # entries a lit row from which tiles can pay
TILED = 0.9  # times the bytes of CSR: what tiles may store, which save bytes and nothing else and are dear to build
PART_ROWS = 2**15  # of the middle, on either side: planning all tiles only to count them is dear
SAMPLES = 4096


def fastest(csr: Csr, cache: Path | None = None) -> SparseFormat:
    """A matrix in the format whose product takes least time on its device.

    The choice is remembered in `cache`, by default `formats.json` in the user's cache folder. A cache that cannot be read or written costs
    the measurement again, nothing else.
    """
    cache = cache_file() if cache is None else cache
    key = _key(csr)
    name = _remembered(cache).get(key)
    if isinstance(name, str) and name in FORMATS:
        return build(csr, name)
    settled = csr.settled()
    forms = {name: FORMATS[name].from_csr(settled) for name in candidates(csr)}
    best = best_of(forms)
    _remember(cache, key, best)
    return forms[best]


def best_of(forms: dict[str, SparseFormat]) -> str:
    """Name of the format whose products take least time."""
    times = timings(forms)
    return min(times, key=times.__getitem__)


def candidates(csr: Csr) -> list[str]:
    """Formats that can pay: those that do not store several times what CSR stores."""
    names = ["scipy"] if csr.values.device.type == "cpu" else []
    names += [name for name in ("csr", "window", "submatrix", "sell", "ell") if _size(csr, name) <= LARGEST]
    lit = lit_rows(csr)
    if len(csr.values) >= LONG_ROWS * len(lit) > 0:
        middle = int(lit[len(lit) // 2])
        part = csr.band(max(middle - PART_ROWS, 0), min(middle + PART_ROWS, csr.n_rows))
        names += [name for name in ("tiles", "tiles64") if _size(part, name) <= TILED]
    return names


def _size(csr: Csr, name: str) -> float:
    """Bytes in a format as a share of those in CSR."""
    dtype = csr.values.dtype
    return FORMATS[name].count(csr).bytes(dtype) / FORMATS["csr"].count(csr).bytes(dtype)


def timings(forms: dict[str, SparseFormat]) -> dict[str, float]:
    """Median ms of a product of each, in turn: process time of one CPU thread, clock time of several; of captured graphs on CUDA.

    All run in the first round. One that falls behind is left out of the next: the longer it lasts, the closer are those compared.
    """
    steps, device = _steps(forms), next(iter(forms.values())).device
    taken: dict[str, list[float]] = {name: [] for name in forms}
    medians: dict[str, float] = {}
    racing, start = list(forms), time.monotonic()
    for number in range(ROUNDS):
        for name in racing:
            steps[name]()  # formats share arrays: none shall find in the caches what another left there
            taken[name].append(_milliseconds(steps[name], device))
            medians[name] = median(taken[name])
        slack = max(FIRST_SLACK / (number + 1), LAST_SLACK)
        racing = [name for name in racing if medians[name] <= (1 + slack) * min(medians[each] for each in racing)]
        if len(racing) == 1 or time.monotonic() - start > ENOUGH_S:
            break
    return medians


def _steps(forms: dict[str, SparseFormat]) -> dict[str, Callable[[], Tensor]]:
    """The product of each as it is best used: into the same memory, on CUDA as a captured graph."""
    first = next(iter(forms.values()))
    x = torch.rand(first.n_cols, dtype=first.dtype, device=first.device)
    if first.device.type != "cuda":
        out = first.multiply(x)
        return {name: partial(form.refresh, x, out) for name, form in forms.items()}
    captured = {name: CapturedProduct(form) for name, form in forms.items()}
    for each in captured.values():
        each(x)
    return {name: each.replay for name, each in captured.items()}


def _milliseconds(step: Callable[[], Tensor], device: torch.device) -> float:
    if device.type == "cuda":
        with torch.cuda.device(device):
            before, after = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
            before.record()
            step()
            after.record()
            after.synchronize()
            return before.elapsed_time(after)
    clock = time.process_time_ns if torch.get_num_threads() == 1 else time.perf_counter_ns
    before_ns = clock()
    step()
    return 1e-6 * (clock() - before_ns)


def cache_file() -> Path:
    """Where choices are remembered."""
    import pooch

    return Path(pooch.os_cache("luxloop")) / "formats.json"


def _key(csr: Csr) -> str:
    """What a choice depends on: the matrix (by samples), its dtype, the device, threads and torch."""
    digest = hashlib.blake2b(digest_size=12)
    for tensor in (csr.indptr, csr.indices, csr.values):
        sample = tensor[:: len(tensor) // SAMPLES + 1].cpu().numpy()
        digest.update(np.ascontiguousarray(sample).tobytes())
    device = csr.values.device
    where = torch.cuda.get_device_name(device) if device.type == "cuda" else f"{processor()}, {torch.get_num_threads()} threads"
    shape = f"{csr.n_rows} x {csr.n_cols}, {len(csr.values)} entries, {digest.hexdigest()}"
    return f"{shape}; {csr.values.dtype}; {where}; torch {torch.__version__}; {' '.join(FORMATS)}"


def processor() -> str:
    """Model of the CPU."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()


def _remembered(cache: Path) -> dict[str, object]:
    try:
        content = json.loads(cache.read_text("utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _remember(cache: Path, key: str, name: str) -> None:
    """Add a choice. Other processes see the old file or the new one; of two that write at once one is forgotten."""
    try:
        cache.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cache.parent) as folder:
            partial = Path(folder) / cache.name
            partial.write_text(json.dumps({**_remembered(cache), key: name}, indent=1) + "\n", "utf-8")
            os.replace(partial, cache)
    except OSError:
        pass
