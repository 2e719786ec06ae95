"""Modules of a lamp description, and how they are built."""

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import torch
from pydantic import Field, model_validator

from luxloop.world.errors import LuxloopError
from luxloop.world.files import afford
from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Module
from luxloop.world.headlight.overlap import Method, OverlapErrors, errors, reduce, standard_use_cases, strongest
from luxloop.world.headlight.parametric import BlurredRectangles, GaussianPixels, InField, headlight
from luxloop.world.headlight.pixels import (
    CUTOFF,
    TEXELS_A_PIXEL,
    PixelArray,
    PixelMatrix,
    affordable,
    assemble,
    border_share,
    default_grid,
    describe,
)
from luxloop.world.headlight.sources import FileSource, FolderSource, TableSource
from luxloop.world.lamps import presets
from luxloop.world.params import Degrees, ModuleName, Params, Slope
from luxloop.world.photometry.distribution import Array
from luxloop.world.spmv import Csr
from luxloop.world.texels import LARGEST_ANGLE_DEG, TexelGrid

DARK_CD = 1e-3  # smaller intensities are rounding residues of a pixel model
TOLD = 0.01  # relative error of flux or peak above which a warning says so
STILL_SHINES = 0.05  # of its peak: a measurement brighter at its border was cut off
BYTES_A_TEXEL = 32  # of a texture while it is made
SIGMAS = 3.5  # of a Gaussian that a default texture holds: all but 0.2 % of the peak

Progress = Callable[[int, int], None]


class PresetSource(Params):
    """A module of a lamp that comes with luxloop."""

    kind: Literal["preset"] = "preset"
    name: str = Field(examples=["hd84"], description="name of the preset; `luxloop headlight list` shows all")
    module: str | None = Field(None, description="module of the preset; left out: the one with the finest pixels")


SourceParams = Annotated[
    FolderSource | FileSource | TableSource | GaussianPixels | BlurredRectangles | PresetSource, Field(discriminator="kind")
]


class TextureParams(Params):
    """Light texture; by default it covers all light, with texels finer than the data."""

    rows: int | None = Field(None, gt=0, le=16384, description="texel rows; left out: finer than the source")
    columns: int | None = Field(None, gt=0, le=16384, description="texel columns; left out: finer than the source")
    left_deg: InField | None = Field(None, description="left border, left positive; borders left out: where the light ends")
    right_deg: InField | None = Field(None, description="right border")
    bottom_deg: InField | None = Field(None, description="lower border, up positive")
    top_deg: InField | None = Field(None, description="upper border")

    def on(self, default: TexelGrid, pixel_rows: int, pixel_cols: int) -> TexelGrid:
        """The grid, with what is left out taken from a default.

        Raises LuxloopError where the borders are in the wrong order, or texels are fewer than pixels.
        """
        for key, given, pixels in (("rows", self.rows, pixel_rows), ("columns", self.columns, pixel_cols)):
            if given is not None and given < pixels:
                raise LuxloopError(
                    f"texture.{key} = {given}: cannot show {pixels} {key} of pixels; give at least {pixels}, better "
                    f"{TEXELS_A_PIXEL * pixels}, or leave it out"
                )
        own = (self.left_deg, self.right_deg, self.bottom_deg, self.top_deg)
        borders = [usual if each is None else each for each, usual in zip(own, default.borders_deg, strict=True)]
        grid = TexelGrid.from_degrees(1, 1, *borders)
        rows = math.ceil((grid.top - grid.bottom) / (default.top - default.bottom) * default.rows)
        cols = math.ceil((grid.left - grid.right) / (default.left - default.right) * default.cols)
        rows, cols = self.rows or rows, self.columns or cols
        afford(f"texture: {rows} x {cols} texels", BYTES_A_TEXEL * rows * cols, "give fewer rows and columns")
        return replace(grid, rows=rows, cols=cols)


class OverlapParams(Params):
    """Overlap reduction: fewer pixels per texel (T 5.2)."""

    keep: int | None = Field(None, ge=1, le=1_000_000, description="number of strongest pixels kept at each texel; left out: all")
    bound_cd: float = Field(0.0, ge=0, le=1e9, description="luminous intensity below which a pixel's light at a texel is dropped")
    method: Method = Field(
        "proportional",
        description="dropped light is lost, shared in proportion by the kept pixels, or shared so that use cases change least: all on, "
        "a checkerboard, random pixels, and the given beams",
    )

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if self.keep is None and self.bound_cd == 0:
            raise ValueError("keep: is missing; give the number of pixels to keep at each texel, or bound_cd")
        return self


Offset = Annotated[float, Field(ge=-2, le=2)]  # m


class MountParams(Params):
    """Pose of a module in its lamp."""

    x_m: Offset = Field(0.0, description="position of the photometric centre ahead of the lamp's origin")
    y_m: Offset = Field(0.0, description="position to the left of it")
    z_m: Offset = Field(0.0, description="height above it")
    roll_deg: Degrees = Field(0.0, description="rotation about the forward axis, right side down positive")
    pitch_deg: Slope = Field(0.0, description="rotation about the left axis, nose down positive: the light moves down")
    yaw_deg: Degrees = Field(0.0, description="rotation about the upward axis, to the left positive")


class ModuleParams(Params):
    """One module of a lamp."""

    name: ModuleName = Field(examples=["fine"], description="name in tables, scenarios and names of files")
    source: SourceParams = Field(examples=[{"kind": "preset", "name": "hd84"}], description="source of its pixels' light")
    texture: TextureParams = Field(TextureParams(), description="size and field of the light texture")
    cutoff: float = Field(CUTOFF, ge=0, lt=1, description="share of a pixel's peak below which its measured light is dropped")
    overlap: OverlapParams | None = Field(None, description="overlap reduction: fewer pixels per texel; left out: none")
    mount: MountParams | None = Field(None, description="pose in the lamp; left out: at its origin, or as in the preset")
    swivel_deg: tuple[Degrees, Degrees] | None = Field(
        None, description="range of swivel, left positive (bending); left out: fixed, or as in the preset"
    )
    level_deg: tuple[Degrees, Degrees] | None = Field(
        None, description="range of levelling, down positive; left out: fixed, or as in the preset"
    )
    draws_only: bool | None = Field(
        None, description="whether default beams leave it dark, for what lighting functions draw; left out: no, or as in the preset"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for key in ("swivel_deg", "level_deg"):
            turn = getattr(self, key)
            if turn is not None and not turn[0] <= 0 <= turn[1]:
                raise ValueError(f"{key}: the range {list(turn)} must hold 0, where the module is mounted")
        if isinstance(self.source, PresetSource) and self.texture != TextureParams():
            raise ValueError("texture: a preset brings its own; leave it out")
        return self


@dataclass(frozen=True)
class ModuleReport:
    """How closely a module reproduces its source.

    entries_per_texel: before and after overlap reduction. dropped: share of the light below `cutoff`, flux, peak, rmse and rmse_cd: against
    the source (see headlight.pixels.PixelMatrix); all None where the source is no measurement. overlap: None where nothing was reduced.
    """

    name: str
    pixel_rows: int
    pixel_cols: int
    rows: int
    cols: int
    entries_per_texel: tuple[float, float]
    dropped: float | None = None
    flux: float | None = None
    peak: float | None = None
    rmse: float | None = None
    rmse_cd: float | None = None
    overlap: OverlapErrors | None = None


def build_module(
    params: ModuleParams, folder: Path, use_cases: Callable[[int, int], Sequence[Array]], on_progress: Progress | None = None
) -> tuple[Module, ModuleReport]:
    """A module and the report on its source. folder: of the description, to which paths are relative.

    use_cases: utilisations `[n_p]` that matter for least squares beside the standard ones, given the pixel rows and columns. Raises:
    LuxloopError where a file is missing or broken, or the texture or preset makes no sense.
    """
    module, assembled = _with_light(params, folder, on_progress)
    full = module.headlight
    light, overlap = full, None
    if _dark(full):
        raise LuxloopError(f"its source lights no texel of the texture ({describe(full)}); widen the texture, or look at the source")
    if params.overlap is not None:
        light, overlap = _reduce_overlap(full, params.overlap, use_cases(full.pixel_rows, full.pixel_cols))
        if _dark(light):
            raise LuxloopError(
                f"overlap: bound_cd = {params.overlap.bound_cd:g} leaves no light; the brightest texel has {full.peak_cd:g} cd"
            )
    given = {key: getattr(params, key) for key in ("swivel_deg", "level_deg", "draws_only")}
    changes: dict[str, Any] = {key: value for key, value in given.items() if value is not None}
    if params.mount is not None:
        m = params.mount
        changes["T_lamp_module"] = pose_from_degrees((m.x_m, m.y_m, m.z_m), m.roll_deg, m.pitch_deg, m.yaw_deg).double()
    return replace(module, headlight=light, **changes), ModuleReport(
        name=params.name,
        pixel_rows=light.pixel_rows,
        pixel_cols=light.pixel_cols,
        rows=light.rows,
        cols=light.cols,
        entries_per_texel=(len(full.matrix.values) / full.n_texels, len(light.matrix.values) / full.n_texels),
        overlap=overlap,
        **({} if assembled is None else {key: getattr(assembled, key) for key in ("dropped", "flux", "peak", "rmse", "rmse_cd")}),
    )


def _dark(light: Headlight) -> bool:
    return not bool((light.matrix.values > DARK_CD).any())


def _with_light(params: ModuleParams, folder: Path, on_progress: Progress | None) -> tuple[Module, PixelMatrix | None]:
    """The module of a source, and its errors against the measurement."""
    source = params.source
    if isinstance(source, PresetSource):
        lamp = presets.lamp(source.name)
        given = lamp.finest if source.module is None else lamp.module(source.module)
        return replace(given, name=params.name), None
    if isinstance(source, GaussianPixels | BlurredRectangles):
        rows = source.rows if isinstance(source, BlurredRectangles) else len(source.row_centres_deg)
        grid = params.texture.on(_grid_of_model(source), rows, source.columns)
        return Module(params.name, headlight(params.name, source, grid)), None
    array = source.model_copy(update={"path": folder / source.path}).pixels()
    grid = params.texture.on(default_grid(array), array.rows, array.columns)
    warn_of_oddities(source, array)
    assembled = assemble(array, grid, params.cutoff, on_progress)
    if len(array.pixels) == 1 and (assembled.flux < 1 - TOLD or abs(assembled.peak - 1) > TOLD):
        warnings.warn(
            f"{source.path}: as a light texture of {grid.rows} x {grid.cols} texels ({describe(grid)}) it has "
            f"{assembled.peak:.1%} of its peak and {assembled.flux:.1%} of its flux; "
            f"texels and borders are keys of [module.texture] in a description, up to {LARGEST_ANGLE_DEG:g} deg from the axis",
            stacklevel=2,
        )
    light = Headlight(
        **vars(grid),
        name=params.name,
        matrix=Csr.from_scipy(assembled.matrix),
        pixel_rows=array.rows,
        pixel_cols=array.columns,
        chroma=None if assembled.chroma is None else torch.from_numpy(assembled.chroma).float(),
    )
    return Module(params.name, light), assembled


def warn_of_oddities(source: FolderSource | FileSource | TableSource, array: PixelArray) -> None:
    """Warn of measurements that are probably wrong."""
    shares = {each: border_share(each) for each in {pixel.distribution for pixel in array.pixels}}  # equal only to themselves
    cut_off = [(shares[pixel.distribution], -j) for j, pixel in enumerate(array.pixels) if shares[pixel.distribution] > STILL_SHINES]
    if cut_off:
        share, worst = max(cut_off)
        row, column = divmod(-worst, array.columns)
        which = "" if len(shares) == 1 else f"the measurement of the pixel in row {row}, column {column} (counted from 0) "
        more = "" if len(shares) == 1 or len(cut_off) == 1 else f", as do {len(cut_off) - 1} more"
        warnings.warn(
            f"{source.path}: {which}ends where it still gives {share:.0%} of its peak{more}; measure farther out, for beyond it is dark",
            stacklevel=2,
        )
    hangs = any(pixel.distribution.type == "C" for pixel in array.pixels)
    if hangs and "aim" not in source.model_fields_set:
        warnings.warn(
            f'{source.path}: is a luminaire\'s file (type C), so its nadir was taken as the beam axis; in a description, aim = "beam" says '
            'that this is right, aim = "nadir" leaves it as it hangs',
            stacklevel=2,
        )


def _reduce_overlap(light: Headlight, params: OverlapParams, given: Sequence[Array]) -> tuple[Headlight, OverlapErrors]:
    """The light with fewer matrix entries, and its errors on random utilisations other than the fitted ones."""
    fitted, evaluated = ([*standard_use_cases(light.pixel_rows, light.pixel_cols, seed=seed), *given] for seed in (0, 1))
    matrix = reduce(light.matrix, params.keep, params.method, fitted, params.bound_cd)
    chroma = light.chroma
    if chroma is not None:
        chroma = chroma[:, torch.from_numpy(strongest(light.matrix, params.keep, params.bound_cd))]
    return replace(light, matrix=matrix, chroma=chroma), errors(light.matrix, matrix, evaluated)


def _grid_of_model(model: GaussianPixels | BlurredRectangles) -> TexelGrid:
    """A texture that holds all light of a pixel model, with texels that are fine for its pixels and their flanks."""
    pitch = (model.left_deg - model.right_deg) / model.columns
    if isinstance(model, BlurredRectangles):
        rows, row = model.rows, (model.top_deg - model.bottom_deg) / model.rows
        across, down = (SIGMAS * model.blur_deg + 0.5 * model.overlap * each for each in (pitch, row))
        bottom, top = model.bottom_deg - down, model.top_deg + down
        texel_y = texel_z = model.blur_deg or math.inf
    else:
        rows = len(model.row_centres_deg)
        across = (SIGMAS * model.column_sigma - 0.5) * pitch
        reach = [(centre, SIGMAS * sigma) for centre, sigma in zip(model.row_centres_deg, model.row_sigmas_deg, strict=True)]
        bottom, top = min(centre - each for centre, each in reach), max(centre + each for centre, each in reach)
        texel_y, texel_z = 0.25 * model.column_sigma * pitch, 0.25 * min(model.row_sigmas_deg)
    left, right = model.left_deg + across, model.right_deg - across
    borders = [min(max(each, -LARGEST_ANGLE_DEG), LARGEST_ANGLE_DEG) for each in (left, right, bottom, top)]
    grid = TexelGrid.from_degrees(1, 1, *borders)  # a texel of the plane is widest on the axis, seen as an angle
    rows = affordable((grid.top - grid.bottom) / math.radians(texel_z), rows)
    cols = affordable((grid.left - grid.right) / math.radians(texel_y), model.columns)
    return replace(grid, rows=rows, cols=cols)
