"""Third-party roads and light distributions by name, found on this machine or fetched from their public sources."""

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

from luxloop.world.errors import LuxloopError, did_you_mean

FOLDER_VARIABLE = "LUXLOOP_DATA"  # folder with copies
MIRROR_VARIABLE = "LUXLOOP_DATA_URL"  # address of a mirror with the registry's paths
TIMEOUT_S = 30.0


@dataclass(frozen=True)
class DataFile:
    """An entry of the registry."""

    name: str
    file: str  # path inside a data folder
    kind: Literal["road", "photometric"]
    description: str
    licence: str
    bytes: int
    sha256: str
    url: str


@dataclass(frozen=True)
class Download:
    """Path of a file, and whether it was downloaded now."""

    path: Path
    downloaded: bool


@cache
def registry() -> Mapping[str, DataFile]:
    """Registered files, by name."""
    entries = tomllib.loads(Path(__file__).with_name("data_registry.toml").read_text("utf-8"))
    return {name: DataFile(name=name, **entry) for name, entry in entries.items()}


def entry(name: str) -> DataFile:
    """A registered file. Raises LuxloopError with the nearest name."""
    if name in (known := registry()):
        return known[name]
    raise LuxloopError(f"there is no data file {name!r}; {did_you_mean(name, known, '`luxloop data list` shows all')}")


def present(name: str) -> Path | None:
    """Path of a registered file on this machine, None if missing: in the folder `LUXLOOP_DATA` (as `roads/X`, `ies/X` or `X`), then among
    fetched files.
    """
    file = Path(entry(name).file)
    own = os.environ.get(FOLDER_VARIABLE)
    if own and not Path(own).is_dir():
        raise LuxloopError(f"{FOLDER_VARIABLE} names {own}, which is not a folder; correct it or unset it")
    candidates = [Path(own) / file, Path(own) / file.name] if own else []
    return next((path for path in [*candidates, cache_folder() / file] if path.is_file()), None)


def find(name: str) -> Path:
    """Path of a registered file on this machine. Raises LuxloopError with the remedy if the file is missing."""
    if (path := present(name)) is not None:
        return path
    raise LuxloopError(f"data file {name!r} is not on this machine; get it with `luxloop data get {name}`")


def locate(name_or_path: str | Path) -> Path:
    """Path of a file in a scenario, given by path or, without a slash or a dot, by registered name."""
    text = str(name_or_path)
    return Path(text) if any(mark in text for mark in "/\\.") else find(text)


def get(name: str, directory: str | Path | None = None) -> Download:
    """Fetch a registered file, whole or not at all, unless the machine has it. directory: by default the folder of fetched files.

    The file comes from its source or from the mirror `LUXLOOP_DATA_URL`. A fetched file whose SHA-256 is not the registered one is fetched
    again. Raises LuxloopError without a connection, for an unknown file, for other content, and for other content in the user's folder
    `LUXLOOP_DATA`.
    """
    import pooch

    known = entry(name)
    target = (cache_folder() if directory is None else Path(directory)) / known.file
    here = (present(name) if directory is None else None) or target
    if here.is_file() and pooch.file_hash(str(here), alg="sha256") == known.sha256:
        return Download(here, downloaded=False)
    if here != target:
        raise LuxloopError(f"{here}: is not {name!r} as registered (SHA-256 differs); move it away, then get {name} again")
    mirror = os.environ.get(MIRROR_VARIABLE)
    _download(known, f"{mirror.rstrip('/')}/{known.file}" if mirror else known.url, target)
    return Download(target, downloaded=True)


def _download(wanted: DataFile, url: str, target: Path) -> None:
    import pooch
    import requests

    pooch.get_logger().setLevel("WARNING")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        downloader = pooch.HTTPDownloader(timeout=TIMEOUT_S)
        pooch.retrieve(url, f"sha256:{wanted.sha256}", target.name, target.parent, downloader=downloader)
    except requests.HTTPError as error:
        remedy = f"save it by hand as {target} or set {MIRROR_VARIABLE} to a mirror"
        raise LuxloopError(f"{target.name} cannot be fetched: {error}; {remedy}") from error
    except requests.RequestException as error:
        remedy = f"connect to the network or set {FOLDER_VARIABLE} to a folder with {wanted.file}"
        raise LuxloopError(f"{url} cannot be reached; {remedy}") from error
    except ValueError as error:
        raise LuxloopError(f"{url} has other content than registered (SHA-256 differs); nothing was kept, try again") from error
    except OSError as error:
        raise LuxloopError(f"{target} cannot be written ({error.strerror or error}); give another folder with --dir") from error


def cache_folder() -> Path:
    """Folder of fetched files."""
    import pooch

    return Path(pooch.os_cache("luxloop"))
