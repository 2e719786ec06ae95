"""Lamps by name or file: presets, lamp files, photometric files, and descriptions in TOML from which lamps are built (T 5.2)."""

import os
import warnings
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self, cast

import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor

from luxloop.world.errors import LuxloopError, did_you_mean, locate
from luxloop.world.files import files_at
from luxloop.world.headlight.lamp import Lamp
from luxloop.world.headlight.sources import SUFFIXES, FileSource
from luxloop.world.lamps import archive, presets
from luxloop.world.lamps.fitting import FittedBeams
from luxloop.world.lamps.modules import ModuleParams, ModuleReport, build_module, warn_of_oddities
from luxloop.world.lamps.utilisations import read_utilisation
from luxloop.world.params import Params
from luxloop.world.photometry import Distribution
from luxloop.world.photometry.distribution import Array
from luxloop.world.regulation.tables import Traffic
from luxloop.world.validation import read_toml, validate_model


@dataclass(frozen=True, kw_only=True)
class MeasuredLamp(Lamp):
    """A lamp of one pixel with the intensity of a photometric file, interpolated between the file's angles; it cannot be rendered.

    mirrored: the lamp of the right side, whose light is that of the left one mirrored.
    """

    distribution: Distribution
    mirrored: bool = False

    def beam(self, name: str) -> tuple[Tensor, ...]:
        """As of Lamp, `full` or `off`: the utilisation `[1]` of the pixel."""
        return (torch.ones(1) if name == "full" else torch.zeros(1),) if name in ("full", "off") else super().beam(name)

    def lit(self, utilisations: Sequence[Tensor]) -> Callable[[Tensor], Tensor]:
        """As of Lamp."""
        share, sides = float(utilisations[0]), np.array([1.0, -1.0 if self.mirrored else 1.0, 1.0])
        return lambda directions: share * torch.from_numpy(self.distribution.intensity(directions.double().numpy() * sides[:, None]))


def measured_lamp(path: Path, side: str) -> MeasuredLamp:
    """The lamp of a photometric file. Raises LuxloopError where it cannot be read; warns of what is odd in it."""
    source = FileSource(path=path)
    array = source.pixels()
    warn_of_oddities(source, array)
    return MeasuredLamp(path.stem, (), distribution=array.pixels[0].distribution, mirrored=side == "right")


Side = Literal["left", "right"]
Progress = Callable[[str, int, int], None]


class BeamsParams(Params):
    """Named beams of a lamp, in addition to `full` and `off`."""

    default: bool = Field(False, description="fit the default beams (low, high and others) to the pixels")
    given: dict[str, dict[str, Path]] = Field(
        {}, description="your own beams: utilisations (.npy, .csv or .png) by names of beam and module; modules left out are dark"
    )


class LampDescription(Params):
    """A complete lamp, for the left side of the car."""

    name: str = Field(min_length=1, max_length=80, examples=["mine"], description="name shown in tables")
    notes: str = Field("", description="notes, such as what is measured and what is assumed")
    module: tuple[ModuleParams, ...] = Field(
        min_length=1,
        examples=[[{"name": "fine", "source": {"kind": "preset", "name": "hd84"}}]],
        description="modules, one [[module]] table each",
    )
    beams: BeamsParams = Field(BeamsParams(), description="named beams")

    @model_validator(mode="after")
    def _names_fit(self) -> Self:
        names = [module.name for module in self.module]
        if len(set(names)) < len(names):
            raise ValueError(f"module: the names {', '.join(names)} are not unique; give each module its own")
        for beam, files in self.beams.given.items():
            if beam in ("full", "off"):
                raise ValueError(f"beams.given.{beam}: every lamp has {beam} already; choose another name")
            for name in files:
                if name not in names:
                    raise ValueError(f"beams.given.{beam}.{name}: there is no such module; {did_you_mean(name, names)}")
        return self


def describe(path: Path) -> LampDescription:
    """Read a description. Raises LuxloopError that names the file, the key and the remedy."""
    if path.suffix.lower() in (".npz", *SUFFIXES):
        what = "a lamp file" if path.suffix.lower() == ".npz" else "a photometric file, which is a lamp of one pixel"
        raise LuxloopError(f"{path}: is {what} already; look at it with `luxloop headlight info` or `show`, or build a description (.toml)")
    return validate(read_toml(path), str(path))


def validate(data: Mapping[str, Any], source: str) -> LampDescription:
    """Check a description given as plain data. Raises LuxloopError that names the source, the key and the remedy."""
    with locate(source):
        return validate_model(LampDescription, data, "`luxloop new --like lamp.toml` copies a complete file")


def build(path: Path, side: Side = "left", on_progress: Progress | None = None) -> tuple[Lamp, tuple[ModuleReport, ...]]:
    """Build the lamp of a description, with a report for each module; default beams are fitted on first use.

    on_progress: called with a module's name, the pixels done and their number. Raises LuxloopError that names the file and the remedy.
    """
    description, folder = describe(path), path.parent
    built = []
    for params in description.module:

        def use_cases(rows: int, columns: int, name: str = params.name) -> Sequence[Array]:
            files = [each[name] for each in description.beams.given.values() if name in each]
            return [read_utilisation(folder / file, rows, columns) for file in files]

        def progress(done: int, of: int, name: str = params.name) -> None:
            if on_progress:
                on_progress(name, done, of)

        try:
            built.append(build_module(params, folder, use_cases, progress))
        except LuxloopError as error:
            raise LuxloopError(f"{path}: module {params.name!r}: {error}") from error
    modules = tuple(module if side == "left" else module.mirror() for module, _ in built)
    bare = Lamp(description.name, modules, notes=description.notes)
    given = {name: _beam(bare, files, folder) for name, files in description.beams.given.items()}
    # A chain writes to its first map alone, and fits the beams of the second when it is asked for them.
    fitted = cast(MutableMapping[str, tuple[Tensor, ...]], FittedBeams(bare) if description.beams.default else {})
    return replace(bare, beams=ChainMap(given, fitted)), tuple(report for _, report in built)


def lamp_files(name: str) -> Iterator[Path]:
    """The files on which a lamp depends: its own and those that a description names; none for a preset.

    Raises LuxloopError where a description is broken.
    """
    path = Path(name)
    if name in presets.NAMES or not os.path.isfile(path):
        return
    yield path
    if path.suffix.lower() == ".toml":
        description = describe(path)
        for module in description.module:
            if source := getattr(module.source, "path", None):
                yield from files_at(path.parent / source)
        yield from (path.parent / file for files in description.beams.given.values() for file in files.values())


def _beam(lamp: Lamp, files: Mapping[str, Path], folder: Path) -> tuple[Tensor, ...]:
    def of(module: str, rows: int, columns: int) -> Tensor:
        if module not in files:
            return torch.zeros(rows * columns)
        return torch.from_numpy(read_utilisation(folder / files[module], rows, columns)).float()

    return tuple(of(module.name, module.headlight.pixel_rows, module.headlight.pixel_cols) for module in lamp.modules)


def load_lamp(name: str | Path, side: Side = "left") -> Lamp:
    """A lamp by a preset's name or a file's path: .npz, .toml, or a photometric file (.ies, .ldt), which is a lamp of one pixel.

    side: of the car. Files describe the left lamp. The right one is its mirror image, and its beams are the same pictures: the modules'
    pixels are counted from the left again. Default beams of a description are fitted anew.
    Raises: LuxloopError with the nearest name, or that names the file and what is wrong in it.
    """
    if str(name) in presets.NAMES:
        return presets.lamp(str(name), side)
    path = Path(name)
    suffix = path.suffix.lower()
    known = (".npz", ".toml", *SUFFIXES)
    if suffix not in known:
        hint = "give a file in it" if str(name) and os.path.isdir(path) else did_you_mean(str(name), presets.NAMES)
        raise LuxloopError(f"there is no lamp {str(name)!r}; {hint} (lamp files end in {', '.join(known)})")
    if not os.path.exists(path):
        raise LuxloopError(f"lamp file {path} does not exist; check the path, or name one of {', '.join(presets.NAMES)}")
    if suffix == ".toml":
        return build(path, side)[0]
    lamp = archive.load(path) if suffix == ".npz" else _of_one_pixel(path)
    return lamp if side == "left" else replace(lamp, modules=tuple(module.mirror() for module in lamp.modules))


def for_traffic(lamp: Lamp, traffic: Traffic) -> Lamp:
    """The lamp with its default beams fitted for traffic on this side; own beams stay, with a warning if it has no others."""
    if traffic == "right":
        return lamp
    maps = lamp.beams.maps if isinstance(lamp.beams, ChainMap) else [lamp.beams]
    if not any(isinstance(each, FittedBeams) for each in maps) and lamp.beams:
        warnings.warn(
            f"lamp {lamp.name!r} has no default beams that could be fitted for traffic on the left, its own stay as they are; "
            "presets have, and descriptions (.toml) with beams.default = true",
            stacklevel=2,
        )
    turned = [each.for_traffic(traffic) if isinstance(each, FittedBeams) else each for each in maps]
    return replace(lamp, beams=ChainMap(*cast(list[MutableMapping[str, tuple[Tensor, ...]]], turned)))


def _of_one_pixel(path: Path) -> Lamp:
    module, _ = build_module(ModuleParams(name=path.stem, source=FileSource(path=path.resolve())), path.parent, lambda *_: [])
    return Lamp(path.stem, (module,), notes=f"One pixel, from {path.name}.")
