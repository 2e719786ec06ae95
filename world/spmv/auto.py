"""Which format is fastest for this lamp on this machine: measured once, then remembered (T 6.1's proposal)."""

import hashlib
import json
import os
import platform
import tempfile
import time
from pathlib import Path
from statistics import median

import numpy as np
import torch

from world.spmv.csr import Csr
from world.spmv.formats import FORMATS
from world.spmv.protocol import SparseFormat, lit_rows

ROUNDS = 7  # of measurements at least, at most ten times as many
ENOUGH_S = 0.3  # of measuring; small lamps take more rounds
LARGEST = 3  # times the bytes of CSR: what a format may store to be considered
LONG_ROWS = 6  # entries a lit row from which tiles can pay
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
        return FORMATS[name].from_csr(csr)
    forms = {name: FORMATS[name].from_csr(csr) for name in candidates(csr)}
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
        names += [name for name in ("tiles", "tiles64") if _size(part, name) <= LARGEST]
    return names


def _size(csr: Csr, name: str) -> float:
    """Bytes in a format as a share of those in CSR."""
    dtype = csr.values.dtype
    return FORMATS[name].count(csr).bytes(dtype) / FORMATS["csr"].count(csr).bytes(dtype)


def timings(forms: dict[str, SparseFormat]) -> dict[str, float]:
    """Median ms of a product of each, in turn: process time of one CPU thread, clock time of several, events on CUDA."""
    steps = {}
    for name, form in forms.items():
        x = torch.rand(form.n_cols, dtype=form.dtype, device=form.device)
        out = form.multiply(x)
        steps[name] = (form, x, form.refresh(x, out))
    taken: dict[str, list[float]] = {name: [] for name in forms}
    start = time.monotonic()
    for number in range(10 * ROUNDS):
        if number >= ROUNDS and time.monotonic() - start > ENOUGH_S:
            break
        for name, (form, x, out) in steps.items():
            form.refresh(x, out)  # formats share arrays: none shall find in the caches what another left there
            taken[name].append(_milliseconds(form, x, out))
    return {name: median(times) for name, times in taken.items()}


def _milliseconds(form: SparseFormat, x: torch.Tensor, out: torch.Tensor) -> float:
    if form.device.type == "cuda":
        with torch.cuda.device(form.device):
            before, after = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
            before.record()
            form.refresh(x, out)
            after.record()
            after.synchronize()
            return before.elapsed_time(after)
    clock = time.process_time_ns if torch.get_num_threads() == 1 else time.perf_counter_ns
    before_ns = clock()
    form.refresh(x, out)
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
    except (OSError, ValueError):
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
