"""Fog, rain and snow in the camera's frames: what lamps and camera see of it, and what a held symbol makes of it."""

import numpy as np
import pytest
import torch

from luxloop import Simulation, load
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.simulation.protocol import Exposure
from luxloop.world.light.emitters import Source
from luxloop.world.light.volumetric import airlight, shadow_map
from luxloop.world.rendering.surfaces import face_source
from tests.loop.conftest import simulated, van

STREET = """
name = "street"
steps = 3
rate_hz = 5
renderer = "raycast"
headlight.model = "hd84"
camera = { width_px = 320, height_px = 180, noise = false }
light = { ambient_lx = 1.0, street_lamps = [{ position_m = [20.0, 5.0, 6.0], intensity_cd = 2000.0 }] }
surface.grain = 0.0
lighting.base.beam = "full"
"""
FOG = "air=[{ visibility_m = 100.0 }]"
VAN = van((12.0, 2.0, 180.0), (11.0, 2.0, 180.0))


RAIN, SNOW = "air=[{ rain_mm_h = 50.0 }]", "air=[{ snow_mm_h = 2.0 }]"


def frames(simulation: Simulation) -> list[torch.Tensor]:
    state, found = simulation.start(), list[torch.Tensor]()
    for _ in range(2):
        state, result = simulation.step(state)
        found += [frame.image[:, :] for frame in result.reception.frames]
    return found


@pytest.mark.parametrize("objects", [[], [VAN]])
def test_clear_air_changes_no_bit(objects):
    clear, entry, fog = (frames(simulated(STREET, *each, objects=objects)) for each in ((), ("air=[{}]",), (FOG,)))
    assert all(torch.equal(a, b) for a, b in zip(clear, entry, strict=True))
    assert not any(torch.equal(a, b) for a, b in zip(clear, fog, strict=True))


@pytest.mark.parametrize("air", [RAIN, SNOW])
def test_each_frame_has_drops_of_its_own(air):
    first, again, other = (frames(simulated(STREET, air, f"seed={seed}")) for seed in (0, 0, 1))
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not any(torch.equal(a, b) for a, b in zip(first, other, strict=True))
    assert not torch.equal(*first), "nothing moves but the drops"


def test_on_and_off_frame_have_different_drops_and_the_mean_of_the_medium():
    """Of 40 frames in the light of the same full beam: within 4 % of the medium, whose own share is a third of the rows' light."""
    plant = simulated(STREET, SNOW).plant
    lights = tuple(Utilisation(each.flux.new_ones(each.flux.shape)) for each in simulated(STREET, SNOW).modules)
    medium, _ = plant.world.luminance(0.0, lights)
    drops = [plant.world.drops(0.0, lights, (), np.random.default_rng(seed)) for seed in range(40)]
    assert float((medium + torch.stack(drops)).min()) > -1e-4
    mean = medium + torch.stack(drops).mean(0)
    assert float(mean[90:].mean()) == pytest.approx(float(medium[90:].mean()), rel=0.04)
    state, images = plant.start()[0], list[torch.Tensor]()
    for number in range(2):
        state, arrivals = plant.show(state, Exposure(number, 0.0, 0.1, lights))
        images += [frame.image for frame in arrivals.frames]
    on, off = images
    assert not torch.equal(on, off)
    part = slice(20, 150), slice(30, 301)
    (once_more,) = plant.show(plant.start()[0], Exposure(0, 0.0, 0.1, lights))[1].frames
    assert torch.equal(once_more.image[part], on[part]), "a part equals that part of the whole"


def test_probes_are_behind_the_air():
    probe = "probes.wall={ position_m = [30.0, 0.0, 1.0] }"
    clear, fog = (simulated(STREET, probe, *each).at(0).probes["wall"] for each in ((), (FOG,)))
    assert clear > 1
    assert fog / clear == pytest.approx(0.05**0.3, rel=1e-3)  # 30 m of 100 m; the lamps are 0.6 m to both sides


def test_the_coarse_grid_agrees_with_every_ray_and_shadow_of_a_van():
    """Rays go to the road instead of to the van, which has no shadow in the air: less than 1 % of error beside it, 17 % on it."""
    simulation = simulated(STREET, FOG, objects=[VAN])
    lights = tuple(each.flux.new_ones(each.flux.shape) for each in simulation.modules)
    (exposure,) = simulation.at(0).exposures
    lit = simulation.world.lit(0.0)
    rays = lit.eye.rays().flatten(1)
    there = lit.surfaces.object_id.flatten() >= 0
    distance = (lit.surfaces.position.flatten(1).double() - lit.eye.origin[:, None]).norm(dim=0).where(there, 400.0)
    exact = torch.zeros(lit.eye.height, lit.eye.width)
    for module, u in zip(lit.modules, lights, strict=True):
        source = Source(module.headlight, module.headlight.light_texture(u), module.T_body_headlight.double())
        shadow = shadow_map(lit.triangles, module.headlight.view(source.T_world_source, 256, 256), face_source("raycast"))
        given = (rays / rays.norm(dim=0)).float(), distance.float(), simulation.world.scene.air_at(0.0)
        exact += airlight(source, lit.eye.origin.float(), *given, 128, shadow).view_as(exact)
    found, bright, on_van = lit.backscattered(exposure.lights), exact > 0.05 * exact.max(), lit.surfaces.object_id > 0
    error = (found / exact - 1).abs()
    assert float(error[bright & ~on_van].median()) < 0.01
    assert float(error[bright & on_van].median()) < 0.2


def test_a_symbol_is_held_in_fog_without_its_backscatter():
    def iou(*overrides: str) -> float:
        simulation = Simulation.prepare(load("flat", ["steps=24", *overrides]))
        last = [float(each.held["symbol"].metrics.iou) for each in simulation.evaluations()][-6:]
        return sum(last) / len(last)

    clear, misled, held = iou(), iou(FOG), iou(FOG, "functions.symbol.extraction.visibility_m=100")
    assert held > 0.85 * clear > misled


def test_a_soiled_lens_and_cover_change_frames_alone_and_light():
    """A lens of 40 % ice darkens nothing in the mean; a cover takes 28 % of the light; the controller knows of neither."""
    clean, lens, cover = (
        simulated(STREET, "camera.saturation_e=100000", *each)
        for each in (
            (),
            ("disturbances.lens=[{ coverage = 0.4, absorption = 0.0, until_step = 1 }]",),
            ("disturbances.cover={ coverage = 0.4, transmission = 0.3 }",),
        )
    )
    of_clean, of_lens, of_cover = map(frames, (clean, lens, cover))
    assert not torch.equal(of_lens[0], of_clean[0])
    assert float(of_lens[0].mean()) == pytest.approx(float(of_clean[0].mean()), rel=5e-3)
    assert torch.equal(of_lens[1], of_clean[1]), "until_step"
    taken, given = (each.world.modules[0].headlight.pixel_flux.sum() for each in (cover, clean))
    assert float(taken / given) == pytest.approx(1 - 0.4 * 0.7, abs=0.15)
    assert torch.equal(cover.modules[0].flux, clean.modules[0].flux)
    assert float(of_cover[0].mean()) < float(of_clean[0].mean())


def test_a_sun_behind_a_van_leaves_no_veil():
    sun = "light.sun={ elevation_deg = 2.0, illuminance_lx = 100.0 }"
    behind, aside = (simulated(STREET, sun, objects=[van((12.0, y, 180.0))]) for y in (0.0, 6.0))
    darkness = [float(frames(each)[0][:60].mean()) for each in (behind, aside, simulated(STREET, objects=[VAN]))]
    assert darkness[0] < 0.5 * darkness[1]
    assert darkness[2] < darkness[1]
