"""Lamp files: a whole lamp in one `.npz`, read again bit for bit. No pickle, so a foreign file cannot run code.

Light is in single precision, as simulations need it; a lamp in double is rounded.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, Self

import numpy as np
import torch
from pydantic import ConfigDict, Field, PositiveInt, ValidationError, model_validator
from torch import Tensor

from luxloop.world.arrays import Arrays, read_npz, write_npz
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import afford, installed_version, reading
from luxloop.world.frames import is_rigid
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import ALWAYS, Lamp, Module
from luxloop.world.params import ModuleName, Params
from luxloop.world.spmv import Csr
from luxloop.world.validation import sentences

FORMAT: Final = "luxloop lamp"
VERSION: Final = 1
WRITER = "`luxloop headlight build` writes it"
BYTES_A_PLACE = 16  # of a pixel or texel, in the matrix' row pointers, textures and utilisations
MOUNT = ("swivel_deg", "level_deg", "draws_only")  # of a module, besides its pose


class ModuleHeader(Params):
    """Properties of a module besides its arrays."""

    name: ModuleName
    headlight: str
    rows: PositiveInt
    cols: PositiveInt
    left: float
    right: float
    bottom: float
    top: float
    pixel_rows: PositiveInt
    pixel_cols: PositiveInt
    swivel_deg: tuple[float, float]
    level_deg: tuple[float, float]
    draws_only: bool = False

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.left <= self.right or self.top <= self.bottom:
            raise ValueError("the borders of a texture are in the wrong order")
        for name, (low, high) in (("swivel_deg", self.swivel_deg), ("level_deg", self.level_deg)):
            if low > high:
                raise ValueError(f"{name} = {low:g} to {high:g} is in the wrong order")
        return self


class Header(Params):
    """The file's entry `header`, as JSON."""

    format: Literal["luxloop lamp"] = FORMAT
    version: Literal[1] = VERSION
    luxloop: str
    name: str
    notes: str
    modules: tuple[ModuleHeader, ...] = Field(min_length=1)
    beams: tuple[str, ...]

    @model_validator(mode="after")
    def _names_are_clear(self) -> Self:
        for what, names in (("module", [module.name for module in self.modules]), ("beam", [*self.beams, *ALWAYS])):
            twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
            if twice is not None:
                raise ValueError(f"{what} {twice!r} occurs twice" + " (every lamp has it)" * (what == "beam" and twice in ALWAYS))
        return self


class _Stamp(Params):
    """The part of a header that every version has."""

    model_config = ConfigDict(extra="ignore")

    format: Literal["luxloop lamp"]
    version: int
    luxloop: str


def save(path: Path, lamp: Lamp) -> None:
    """Write a lamp, whole or not at all; equal lamps give equal bytes.

    Raises: LuxloopError where path does not end in .npz or cannot be written, and where names of modules or beams are not clear.
    """
    if path.suffix != ".npz":
        raise LuxloopError(f"{path}: the name of a lamp file ends in .npz; write for example {path.with_suffix('.npz')}")
    try:
        header = _header_of(lamp)
    except ValidationError as error:
        raise LuxloopError(f"{path}: cannot be written, for {sentences(error, Header, WRITER)[0]}; correct the lamp") from error
    write_npz(path, _arrays(header, lamp))


def load(path: Path) -> Lamp:
    """Read a lamp. Raises LuxloopError where the file is missing, foreign, newer than this luxloop or damaged."""
    with reading(path, "damaged, or no lamp file of luxloop", "build it again with `luxloop headlight build`"):
        arrays = read_npz(path)
        header = _header(path, arrays)
        with locate(str(path)):
            return _lamp(header, arrays)


def _header_of(lamp: Lamp) -> Header:
    return Header(
        luxloop=installed_version(),
        name=lamp.name,
        notes=lamp.notes,
        modules=tuple(_module_header(module) for module in lamp.modules),
        beams=tuple(lamp.beams),
    )


def _arrays(header: Header, lamp: Lamp) -> Iterator[tuple[str, Any]]:
    """All entries of the file by name, the header first."""
    yield "header", np.frombuffer(header.model_dump_json(indent=1).encode(), np.uint8)
    for i, module in enumerate(lamp.modules):
        light = module.headlight
        yield f"module{i}_pose", _host(module.T_lamp_module)
        yield f"module{i}_indptr", _host(light.matrix.indptr)
        yield f"module{i}_indices", _host(light.matrix.indices)
        yield f"module{i}_values", _host(light.matrix.values.float())
        if light.chroma is not None:
            yield f"module{i}_chroma", _host(light.chroma.float())
        for k, us in enumerate(lamp.beams.values()):
            yield f"module{i}_beam{k}", _host(us[i].float())


def _host(tensor: Tensor) -> np.ndarray[Any, Any]:
    return tensor.detach().cpu().numpy()


def _module_header(module: Module) -> ModuleHeader:
    light = module.headlight
    grid = {name: getattr(light, name) for name in ("rows", "cols", "left", "right", "bottom", "top", "pixel_rows", "pixel_cols")}
    mount = {name: getattr(module, name) for name in MOUNT}
    return ModuleHeader(name=module.name, headlight=light.name, **mount, **grid)


def _header(path: Path, arrays: Arrays) -> Header:
    if "header" not in arrays:
        raise LuxloopError(f"{path}: not a lamp file of luxloop, as it has no header; give a file that `luxloop headlight build` wrote")
    text = arrays["header"].tobytes()
    try:
        stamp = _Stamp.model_validate_json(text)
        if stamp.version > VERSION:
            raise LuxloopError(
                f"{path}: written by luxloop {stamp.luxloop} as version {stamp.version}, but this luxloop reads up to {VERSION}; update it"
            )
        return Header.model_validate_json(text)
    except ValidationError as error:
        raise LuxloopError(
            f"{path}: header: {sentences(error, Header, WRITER)[0]}; build the file again with `luxloop headlight build`"
        ) from error


def _lamp(header: Header, arrays: Arrays) -> Lamp:
    """Put the lamp together; ValueError or KeyError where an array is not what the header promises."""
    modules = tuple(_module(each, f"module{i}", arrays) for i, each in enumerate(header.modules))
    beams = {
        name: tuple(
            _tensor(arrays, f"module{i}_beam{k}", (module.headlight.n_pixels,), np.float32, _share) for i, module in enumerate(modules)
        )
        for k, name in enumerate(header.beams)
    }
    return Lamp(header.name, modules, MappingProxyType(beams), header.notes)


def _module(header: ModuleHeader, prefix: str, arrays: Arrays) -> Module:
    n_pixels, n_texels = header.pixel_rows * header.pixel_cols, header.rows * header.cols
    afford(f"module {header.name!r}", BYTES_A_PLACE * (n_pixels + n_texels), "give it fewer pixels or a coarser texture")
    indptr = _tensor(arrays, f"{prefix}_indptr", (n_texels + 1,), np.int32, lambda a: a[0] == 0 and (np.diff(a) >= 0).all())
    nnz = int(indptr[-1])
    indices = _tensor(arrays, f"{prefix}_indices", (nnz,), np.int32, lambda a: ((a >= 0) & (a < n_pixels)).all())
    values = _tensor(arrays, f"{prefix}_values", (nnz,), np.float32, lambda a: np.isfinite(a).all() and (a >= 0).all())
    chroma = (
        _tensor(arrays, f"{prefix}_chroma", (3, nnz), np.float32, lambda a: np.isfinite(a).all()) if f"{prefix}_chroma" in arrays else None
    )
    pose = _tensor(arrays, f"{prefix}_pose", (4, 4), np.float64, is_rigid)
    grid = header.model_dump(exclude={"name", "headlight", *MOUNT})
    light = Headlight(name=header.headlight, matrix=Csr(indptr, indices, values, n_pixels), chroma=chroma, **grid)
    return Module(header.name, light, pose, **{name: getattr(header, name) for name in MOUNT})


def _share(array: np.ndarray[Any, Any]) -> np.bool_:
    return ((array >= 0) & (array <= 1)).all()


def _tensor(arrays: Arrays, name: str, shape: tuple[int, ...], dtype: type, valid: Callable[[np.ndarray[Any, Any]], Any]) -> Tensor:
    array = arrays[name]
    if array.shape != shape or array.dtype != dtype or not valid(array):
        raise ValueError(f"{name} is not what the header says")
    return torch.from_numpy(array)
