"""Map and reduce against the plain sums of T eq. 7.4.1 and 7.4.5, entry by entry."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from pydantic import ValidationError
from torch import Tensor

from luxloop.controllers.pixels.mrpc import FAINT, reduce_setpoints
from luxloop.controllers.pixels.pixel_major import MrpcParams, PixelMajor
from luxloop.controllers.pixels.primitives import I_V, QUANTITIES, Quantity
from luxloop.controllers.pixels.rthc import Setpoints
from luxloop.controllers.pixels.windows import whole
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.presets import idealised
from luxloop.world.spmv import Csr
from luxloop.world.texels import Window
from tests.reference import ssc as reference

ROWS, COLS, PIXELS = 6, 8, 12
DARK_PIXEL, DARK_TEXEL = 5, 17


def lamp_of(light: np.ndarray, texels: tuple[int, int], pixels: tuple[int, int]) -> Headlight:
    """A lamp of a dense matrix `[texels, pixels]`; rows and columns of both."""
    (rows, cols), (pixel_rows, pixel_cols), matrix = texels, pixels, Csr.from_scipy(sp.csr_array(light), torch.float64)
    field = {"left": 0.2, "right": -0.2, "bottom": -0.1, "top": 0.1}
    return Headlight(name="lamp", matrix=matrix, rows=rows, cols=cols, pixel_rows=pixel_rows, pixel_cols=pixel_cols, **field)


def random_lamp(seed: int) -> tuple[Headlight, np.ndarray]:
    """A lamp with overlapping pixels and its dense matrix `[48, 12]`: one pixel has no texel, one texel no pixel, some entries are zero."""
    generator = np.random.default_rng(seed)
    A = generator.uniform(1, 1000, (ROWS * COLS, PIXELS)) * (generator.random((ROWS * COLS, PIXELS)) < 0.25)
    A[:, DARK_PIXEL] = A[DARK_TEXEL] = 0
    lamp = lamp_of(A, (ROWS, COLS), (3, 4))
    lamp.matrix.values[::9] = 0
    return lamp, lamp.matrix.to_scipy().toarray()


def random_setpoints(seed: int, A: np.ndarray, quantity: Quantity, window: Window | None = None) -> Setpoints:
    """Setpoints from far too little to more than the lamp can give, where about two thirds of the rays hit."""
    window = window or Window(0, ROWS, 0, COLS)
    generator = np.random.default_rng(seed + 100)
    value = generator.uniform(0, 1.5, (ROWS, COLS))
    if quantity in ("I_v", "E_v"):
        value *= A.sum(1).reshape(ROWS, COLS)
    hit = generator.random((ROWS, COLS)) < 0.67
    value[~hit] = 0
    cut = slice(window.v_start, window.v_stop), slice(window.u_start, window.u_stop)
    return Setpoints(torch.from_numpy(value[cut].copy()), torch.from_numpy(hit[cut].astype(float)), window, (QUANTITIES.index(quantity),))


def rays(setpoints: Setpoints) -> list[reference.Ray]:
    """The same for the reference, texel by texel."""
    value, hit = setpoints.value, setpoints.hit
    weight = torch.ones_like(value) if setpoints.weight is None else setpoints.weight
    code = torch.full_like(value, setpoints.quantities[0]) if setpoints.quantity is None else setpoints.quantity
    images = (hit.flatten().tolist(), value.flatten().tolist(), weight.flatten().tolist(), code.flatten().tolist())
    return [reference.Ray(h, v, w, QUANTITIES[int(q)]) if h else reference.Ray() for h, v, w, q in zip(*images, strict=True)]


def reduced(setpoints: Setpoints, lamp: Headlight, params: MrpcParams, default: Tensor) -> tuple[Tensor, slice]:
    return reduce_setpoints(setpoints, PixelMajor(lamp, params), params, default)


def base_pattern(seed: int) -> Tensor:
    return torch.rand(PIXELS, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("given", [{"a_m": -1}, {"a_m": 9}, {"a_r": 9}, {"lower_cd": 500, "upper_cd": 100}])
def test_exponents_out_of_bounds_and_bounds_in_the_wrong_order_are_refused(given):
    with pytest.raises(ValidationError, match=r"a_|below lower_cd"):
        MrpcParams(**given)


@pytest.mark.parametrize("quantity", ["I_v", "u_abs"])
@pytest.mark.parametrize(("a_m", "a_r"), [(8.0, 1.0), (1.0, 8.0), (8.0, 8.0)])
def test_great_exponents_stay_within_single_precision(a_m, a_r, quantity):
    """A candela to the power of eight does not: 1e5^8."""
    lamp, A = random_lamp(2)
    bright = replace(lamp, matrix=replace(lamp.matrix, values=100 * lamp.matrix.values))
    setpoints, default, params = random_setpoints(2, 100 * A, quantity), base_pattern(2), MrpcParams(a_m=a_m, a_r=a_r)
    expected, _ = reference.map_reduce(100 * A, rays(setpoints), params, default.numpy(), COLS)
    single = replace(bright, matrix=bright.matrix.to(torch.float32))
    u, _ = reduced(replace(setpoints, value=setpoints.value.float(), cover=setpoints.cover.float()), single, params, default.float())
    # float32: eighth powers of numbers that are right to 6e-8.
    np.testing.assert_allclose(u, expected, rtol=0, atol=1e-5)


def one_pixel(light: list[float]) -> Headlight:
    """A pixel alone on a row of texels."""
    return lamp_of(np.array(light)[:, None], (1, len(light)), (1, 1))


def asked(*setpoints: float) -> Setpoints:
    value = torch.tensor([setpoints], dtype=torch.float64)
    return Setpoints(value, torch.ones_like(value), Window(0, 1, 0, len(setpoints)), (I_V,))


def test_the_pixel_of_the_check_values():
    """Setpoints 0, 0, s, s for a pixel of 0.13, 0.35, 0.95, 1.3 cd: least squares at s 2.25 / 2.7319, if no bound cuts s."""
    pixel, dark = one_pixel([0.13, 0.35, 0.95, 1.3]), torch.zeros(1, dtype=torch.float64)
    u, _ = reduced(asked(0, 0, 0.9, 0.9), pixel, MrpcParams(a_r=2), dark)
    assert u.item() == pytest.approx(0.9 * 2.25 / 2.7319)
    u, _ = reduced(asked(0, 0, 1, 1), pixel, MrpcParams(a_r=2), dark)
    assert u.item() == pytest.approx((0.95**2 + 1.3) / 2.7319), "0.95 cd is all that the third texel can get"
    # Of equal texels above 0.9 of the peak there is one: the pixel's stray light is not asked.
    u, _ = reduced(asked(0, 0, 1, 1), pixel, MrpcParams(a_x=0.9), dark)
    assert u.item() == pytest.approx(1 / 1.3)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("bounds", [{}, {"upper_cd": 100.0}], ids=["products", "entries"])
@pytest.mark.parametrize("texels", [25, 100])
def test_only_a_smaller_share_than_the_decimal_is_off(texels, bounds, dtype):
    """7 of 25 lit setpoints are a share of 0.28, which they are not in floating point."""
    lamp = one_pixel([1.0] * texels)
    lamp = replace(lamp, matrix=lamp.matrix.to(dtype))
    value = torch.ones(texels + 1, texels, dtype=dtype).tril(-1)[:, None]  # 0, 1, 2, ... lit ones
    setpoints = Setpoints(value, torch.ones_like(value), Window(0, 1, 0, texels), (I_V,))
    for percent in range(0, 100, 100 // texels):
        u, _ = reduced(setpoints, lamp, MrpcParams(a_ac=float(f"0.{percent:02}"), **bounds), torch.zeros(1, dtype=dtype))
        least = max(percent * texels // 100, 1)
        assert u[:, 0].nonzero()[0].item() == least, f"a_ac 0.{percent:02}"


def test_sharpening_raises_edges_and_nothing_else():
    lamp = idealised(1, 40)
    value = torch.zeros(lamp.rows, lamp.cols, dtype=torch.float32)
    value[:, 20:60] = 20_000
    setpoints = Setpoints(value, (value > 0).float(), whole(lamp), (I_V,))
    dark = torch.zeros(40)
    plain, sharp = (reduce_setpoints(setpoints, PixelMajor(lamp, p), p, dark, True)[0] for p in (MrpcParams(), MrpcParams(sharpening=0.3)))
    assert (sharp[10] / plain[10]).item() > 1.05
    assert torch.equal(sharp[:9], torch.zeros(9))
    # Above and below there is no light either: everywhere the upper and lower rows are edges, the columns' middle is not.
    assert sharp[20] < sharp[10]
    tall = idealised(20, 40)
    filled = torch.full((tall.rows, tall.cols), 20_000.0)
    everywhere_lit = Setpoints(filled, torch.ones_like(filled), whole(tall), (I_V,))
    p = MrpcParams(sharpening=0.3)
    u = reduce_setpoints(everywhere_lit, PixelMajor(tall, p), p, torch.zeros(800), True)[0].view(20, 40)
    torch.testing.assert_close(u[5:15, 5:35], torch.full((10, 30), 0.4), rtol=1e-5, atol=0)


@pytest.mark.parametrize("quantity", ["I_v", "E_v", "u_abs", "u_rel"])
@pytest.mark.parametrize("values", [{}, {"a_m": 0.5, "a_ac": 0.3}, {"a_d": 1.2, "a_x": 0.4}], ids=str)
def test_corrections_add_what_the_light_lacks(values, quantity):
    lamp, A = random_lamp(8)
    default, plain = base_pattern(8), MrpcParams(**values)
    setpoints = random_setpoints(8, A, quantity)
    wanted = rays(setpoints)
    total = A.sum(1)
    unit = {"I_v": np.ones(len(A)), "E_v": np.ones(len(A)), "u_abs": total, "u_rel": A @ default.numpy()}[quantity]
    if plain.a_d is not None:
        unit = unit * np.minimum(total / (total[total > 0].mean() * plain.a_d), 1)
    asked = wanted
    for corrections in range(4):
        expected, _ = reference.map_reduce(A, asked, plain, default.numpy(), COLS)
        u, _ = reduced(setpoints, lamp, plain.model_copy(update={"corrections": corrections}), default)
        # float64 sums over at most 48 texels, each correction of which divides by unit once.
        np.testing.assert_allclose(u, expected, rtol=0, atol=1e-10)
        given = np.divide(A @ expected, unit, out=np.zeros(len(A)), where=unit > 0)
        raised = [max(now.value + ray.value - got, FAINT * ray.value) for now, ray, got in zip(asked, wanted, given, strict=True)]
        asked = [replace(ray, value=value) for ray, value in zip(wanted, raised, strict=True)]


def test_corrections_leave_masks_dark():
    lamp = idealised(12, 40)
    value = torch.zeros(lamp.rows, lamp.cols)
    value[10:, 20:60] = 10_000
    mask = torch.zeros_like(value)
    mask[12:14, 30:34] = 1
    setpoints = Setpoints(value * (1 - mask), torch.ones_like(value), whole(lamp), (I_V,), 1 - mask, mask, masking=True)
    plain, corrected = (
        reduce_setpoints(setpoints, PixelMajor(lamp, p), p, torch.zeros(lamp.n_pixels), dark=True)[0]
        for p in (MrpcParams(), MrpcParams(corrections=2))
    )
    assert (lamp.light_texture(corrected)[mask > 0] == 0).all()
    assert torch.equal(corrected > 0, plain > 0)
    assert (corrected > plain).any()


@pytest.mark.parametrize("quantity", ["I_v", "u_rel"])
def test_a_batch_of_corrections_is_a_loop_of_singles(quantity, device):
    lamp, A = random_lamp(9)
    params, default = MrpcParams(corrections=2, a_ac=0.2), base_pattern(9).to(device)
    window = Window(1, 5, 2, 7)
    singles = [random_setpoints(seed, A, quantity, window) for seed in range(3)]
    singles = [replace(each, value=each.value.to(device), cover=each.cover.to(device)) for each in singles]
    stacked = Setpoints(
        torch.stack([each.value for each in singles]), torch.stack([each.cover for each in singles]), window, singles[0].quantities
    )
    u, _ = reduced(stacked, lamp.to(device), params, default)
    for k, single in enumerate(singles):
        # float64; a setpoint of one may be divided by hundreds of cd.
        torch.testing.assert_close(u[k], reduced(single, lamp.to(device), params, default)[0], rtol=0, atol=1e-12)
