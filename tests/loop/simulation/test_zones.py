"""Zones and materials through the whole chain: lamps, shadows, camera with noise, loop, recording."""

from typing import Any

import pyarrow.parquet as pq
import pytest
from rich.console import Console

from luxloop import Scenario, run
from luxloop.controllers.functions.zone import ZoneParams, region_of
from luxloop.loop.report.picture import marks
from luxloop.loop.report.run_table import summary_table
from tests.loop.conftest import box, scenario_of, simulation_of, toml

ZONES = """
name = "zones"
steps = 11
renderer = "raycast"
headlight.model = "ssl-hd-lores"
camera = { width_px = 320, height_px = 180, oversampling = 1, saturation_e = 2000, pitch_deg = 1.5 }
light.ambient_lx = 0.1
surface = { grain = 0.0, markings = true }
"""
ZONE = toml("{ kind = 'zone', centre_m = [15, 0, 1.0], size_m = [0, 1.6, 1.6], luminance_cd_m2 = 0.6 }")
WALLS = {0.05: 3.0, 0.2: 0.0, 0.8: -3.0}  # y in m by reflectance


def wall(name: str, x: float, y: float, albedo: float) -> dict[str, Any]:
    return box(name, (0.2, 2, 2), (x, y, 0.0), albedo=albedo)


def scenario(functions: dict[str, dict[str, Any]], **changes: Any) -> Scenario:
    walls = [wall(f"wall_{100 * albedo:.0f}", 15.1, y, albedo) for albedo, y in WALLS.items()]
    return scenario_of(ZONES, functions=functions, **{"objects": walls, **changes})


def test_zones_settle_within_10_steps_over_all_reflectances(tmp_path):
    zones = {f"of_{100 * albedo:.0f}": ZONE | {"centre_m": [15, y, 1.0]} for albedo, y in WALLS.items()}
    result = run(scenario(zones), tmp_path / "zones", video=False, report=False)
    for zone in result.summary["zones"].values():
        assert zone["luminance"] == pytest.approx(0.6, rel=0.02) and zone["settled_step"] <= 10
    lx = [result.trajectory[f"functions.{name}.lx"][-1].as_py() for name in zones]
    # 0.1 lx of ambient light on upright walls and the dark rims of the zones aside, light goes with one over the reflectance
    assert lx[0] / lx[1] == pytest.approx(4.0, rel=0.2) and lx[1] / lx[2] == pytest.approx(4.0, rel=0.2)


def test_a_white_wall_in_the_low_beam_settles_as_its_zone_counts_more_than_the_beam():
    def beyond(**more: float) -> list[int]:
        """Steps in which the luminance is more than 5 % off."""
        zone = ZONE | {"centre_m": [25, 0, 1.0], "luminance_cd_m2": 0.9} | more
        given = scenario({"wall": zone}, objects=[wall("white", 25.1, 0.0, 0.8)], lighting={"base": {"beam": "low"}})
        seen = [result.zones["wall"].luminance or 0.0 for result in simulation_of(given).evaluations()]
        return [step for step, each in enumerate(seen) if abs(each / 0.9 - 1) > 0.05]

    # with 1 the beam's light at the foot of the wall is more than the zone can take away, and clipped besides
    assert beyond()[-1] < 5 and beyond(weight=1.0)[-1] == 10


def test_zones_are_drawn_where_the_camera_sees_them():
    simulation = simulation_of(scenario({"to_the_back": ZONE | {"centre_m": [-15, 0, 1.0]}, "in_front": ZONE}, objects=[]))
    _, result = simulation.step(simulation.start())
    result = simulation.evaluate(result)
    ahead, behind = marks(result, simulation)
    assert ahead.text == "in front" and not behind.lines and not behind.text
    function = simulation.scenario.functions["in_front"]
    assert isinstance(function, ZoneParams)
    rows, columns = (index.tolist() for index in region_of(function, simulation.world.view).nonzero(as_tuple=True))
    drawn = [point for line in ahead.lines for point in line]
    # corners are rounded to pixels, whose centres the region counts
    for values, inside in zip(zip(*drawn, strict=True), (columns, rows), strict=True):
        assert min(values) == pytest.approx(min(inside), abs=1) and max(values) == pytest.approx(max(inside), abs=1)
    assert ahead.at == tuple(min(values) for values in zip(*drawn, strict=True))


def test_materials_are_told_beside_what_was_wanted(tmp_path):
    lights = [
        {"materials": ["lane_paint"], "lx": 8.0},
        toml("{ materials = ['matt', 'skin'], luminance_cd_m2 = 0.2 }"),
        toml("{ albedo = [0.0, 0.3], lx = 1.0 }"),
    ]
    told = [{**each.model_dump(exclude_none=True), "category": "other"} for each in scenario({}).objects]
    given = scenario({"by_material": {"kind": "material", "lights": lights, "road_m": [12, 30]}}, objects=told, steps=2)
    summary = run(given, tmp_path / "materials", video=False).summary
    table = pq.read_table(tmp_path / "materials" / "trajectory.parquet")
    materials = {name.removeprefix("by_material."): each for name, each in summary["materials"].items()}
    wanted = [("matt", 0.2), ("skin", 0.2), ("lane_paint", 8.0), ("albedo 0 to 0.3", 1.0)]
    assert [(name, each["wanted"]) for name, each in materials.items()] == wanted
    # the median wall is clear of borders, and light of the road's picture reaches it not at all; rays are read at texels
    assert materials["matt"]["median"] == pytest.approx(0.2, rel=0.15) and materials["matt"]["quantity"] == "luminance"
    assert materials["skin"]["median"] is None
    assert table["functions.by_material.albedo 0 to 0.3.lx"].to_pylist()[0] == pytest.approx(
        0.0, abs=1e-6
    )  # nothing is drawn before anything is seen
    assert materials["albedo 0 to 0.3"]["median"] == pytest.approx(1.0, rel=0.3)  # asphalt, with the seams of what stands
    console = Console(record=True, width=160)
    console.print(
        summary_table(summary | {"materials": summary["materials"] | {"by_material.matt": materials["matt"] | {"median": 0.1}}}, "here")
    )
    assert "0.2 cd/m^2 wanted: 0.1 cd/m^2 (50% of it), median" in console.export_text(clear=False)
    assert "material by material: skin             0.2 cd/m^2 wanted: out of sight" in console.export_text()
