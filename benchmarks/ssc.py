"""How fast primitives become pixel utilisations: `python benchmarks/ssc.py [--json FILE] [--quick]`.

SuperSampling Control of 1.05 million pixels and 3.07 million rays beside one product with the headlight matrix and beside the same in
plain torch; and the lamps of the thesis' tables B.1 to B.4. In process time of one thread, all in turn. On CUDA also as captured graphs,
in clock time with synchronisation.
"""

import itertools
import math
import sys
from argparse import Namespace
from functools import partial
from typing import Any

import torch
from bench import Goal, interleaved, on_gpu, run, show
from lamps import wide_lamp
from torch import Tensor

from luxloop import Ssc, concatenate, pose_from_degrees, rectangle, road_symbol
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.world.headlight import Headlight
from luxloop.world.spmv import row_of_entries

T_WORLD_LAMP = pose_from_degrees((0.0, 0.6, 0.75))
BOARDS = (4, 9)
COVER = 0.925  # of a board's share of the field along each axis, for 77 % in all
KINDS = (("u_abs", 1.0, 1.0), ("E_v", 2.0, 1.0), ("u_abs", 0.0, math.inf), ("I_v", 800.0, 2.0))  # quantity, value, weight


def picture(seed: int) -> Tensor:
    return torch.rand(256, 128, generator=torch.Generator().manual_seed(seed))


def symbol() -> Primitives:
    """256 x 128 grey values on the road."""
    return road_symbol(torch.tensor([14.0, 0.6, 0.0, 0.0]), 0.0, 2.15, 4.9, picture(1), 1.0, "u_abs")


def boards() -> Primitives:
    """36 boards at several distances all over the field: lit, asked for lx and cd, masked, with images, forced and not."""
    tall, wide = (2 * math.tan(math.radians(half_deg)) / n for half_deg, n in zip((5.0, 10.0), BOARDS, strict=True))
    found = []
    for k, (row, col) in enumerate(itertools.product(*map(range, BOARDS))):
        x = 20.0 + k % 7
        y, z = x * wide * (col - (BOARDS[1] - 1) / 2), x * tall * (row - (BOARDS[0] - 1) / 2)
        w, h = 0.9 * COVER * wide * x, COVER * tall * x
        quantity, value, weight = KINDS[k % 4]
        origin = T_WORLD_LAMP[:3, 3].float() + torch.tensor([x, y + w / 2, z + h / 2])
        edges = torch.tensor([0.0, -w, 0.0]), torch.tensor([0.0, 0.0, -h])
        more = {"weight": weight, "symbol": picture(2) if k % 9 == 3 else None, "forced": k % 5 == 0, "priority": k % 3}
        found.append(rectangle(origin, *edges, value, quantity, normal=torch.tensor([-1.0, 0.0, 0.0]), **more))  # type: ignore[arg-type]
    return concatenate(*found)


class Plain:
    """SSC of one symbol as it is first written in torch: stored rays, a solver a ray, and every entry of the matrix one by one."""

    def __init__(self, light: Headlight) -> None:
        entries = light.matrix
        self.texel, self.pixel, self.I_m, self.light = row_of_entries(entries), entries.indices.long(), entries.values, light
        y, z = light.tangents(torch.float32, torch.device("cpu"))
        z, y = torch.meshgrid(z, y, indexing="ij")
        rays = torch.stack([torch.ones_like(y), y, z], -1).reshape(-1, 3)
        self.rays = rays / rays.norm(dim=1, keepdim=True) @ T_WORLD_LAMP[:3, :3].T.float()

    def __call__(self, primitive: Primitives) -> Tensor:
        """Utilisation `[n_p]`."""
        origin, d1, d2, normal = (v[0] for v in (primitive.origin, primitive.d1, primitive.d2, primitive.normal))
        system = torch.stack([self.rays, (-d1).expand_as(self.rays), (-d2).expand_as(self.rays)], -1)
        length, u, v = torch.linalg.solve(system, (origin - T_WORLD_LAMP[:3, 3].float()).expand_as(self.rays)).unbind(-1)
        hit = (length > 0) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1) & (self.rays @ normal < 0)
        place = torch.stack([2 * u - 1, 2 * v - 1], -1)[None, None]
        image = primitive.symbols[0][None, None]
        seen = torch.nn.functional.grid_sample(image, place, padding_mode="border", align_corners=False)[0, 0, 0]
        setpoint = torch.where(hit, seen * primitive.value[0], 0.0)
        I_s = (self.I_m * setpoint[self.texel]).clamp(min=0).minimum(self.I_m)
        zero = torch.zeros(self.light.n_pixels)
        total = zero.index_add(0, self.pixel, self.I_m)
        return (zero.index_add(0, self.pixel, self.I_m * (I_s / self.I_m)) / total).nan_to_num().clamp(0, 1)


def large(light: Headlight, rounds: int) -> dict[str, float]:
    """Ms of the symbol and the many primitives beside one product, and of the symbol in plain torch, after a look at its result."""
    one, many, ssc, plain = symbol(), boards(), Ssc.prepare(light), Plain(light)
    apart = (ssc.utilisation(one, T_WORLD_LAMP).u - plain(one)).abs()
    if not (apart > 1e-3).double().mean() < 1e-4:  # rays at the outline may fall either way
        sys.exit(f"not the same work: plain torch differs by {apart.max():.3g}")
    u, out = torch.rand(light.n_pixels, generator=torch.Generator().manual_seed(1)), torch.empty(light.n_texels)
    steps = {
        "product": lambda: torch.mv(light.matrix.torch_csr, u, out=out),
        "symbol": lambda: ssc.utilisation(one, T_WORLD_LAMP),
        "many": lambda: ssc.utilisation(many, T_WORLD_LAMP),
    }
    return interleaved(steps, rounds) | interleaved({"plain": lambda: plain(one)}, max(rounds // 4, 1))


def gpu_ms(light: Headlight, scene: Primitives) -> float | None:
    """Ms of a captured control step; None without CUDA."""
    if not torch.cuda.is_available():
        return None
    ssc, there = Ssc.prepare(light.to(torch.device("cuda"))), scene.to(torch.device("cuda"))
    T = T_WORLD_LAMP.to("cuda", torch.float32)
    return on_gpu({"": lambda: ssc.utilisation(there, T)})[""]


def measure(given: Namespace) -> dict[str, Any]:
    biggest = wide_lamp(*given.large)
    ms = large(biggest, given.rounds)
    show(f"{biggest.n_pixels:,} pixels, {biggest.n_texels:,} rays, {len(biggest.matrix.values):,} entries", {"ms": ms})
    many, lights = boards(), {name: wide_lamp(*size) for name, size in given.sizes.items()}
    steps = {name: partial(Ssc.prepare(light).utilisation, many, T_WORLD_LAMP) for name, light in lights.items()}
    found = {
        name: {
            "pixels": lights[name].n_pixels,
            "rays": lights[name].n_texels,
            "ms": each,
            "ns a ray": 1e6 * each / lights[name].n_texels,
            "thesis, µs": {number: us[name] for number, us in given.thesis_us.items() if name in us},
            "GPU, ms": gpu_ms(lights[name], many),
        }
        for name, each in interleaved(steps, given.rounds).items()
    }
    show("36 primitives on 77 % of the field", found)
    goals = [
        Goal("symbol on 5 %, times one product", ms["symbol"] / ms["product"], 1.5),
        Goal("symbol on 5 %, times faster than plain torch", ms["plain"] / ms["symbol"], 15.0, True),
        Goal("36 primitives on 77 %, times one product", ms["many"] / ms["product"], 5.0),
        Goal("cost a ray of 36 primitives, largest lamp to 1 k pixels", found[list(found)[-1]]["ns a ray"] / found["1k"]["ns a ray"], 1.2),
        Goal("ms as a graph on a GPU, symbol on 5 %", gpu_ms(biggest, symbol()), 0.15),
    ]
    return {"large": ms, "sizes": found, "goals": goals}


if __name__ == "__main__":
    run(measure, __doc__)
