"""Bodies of the training scenes beside those of the first population."""

import numpy as np
import pytest
import torch

from luxloop import validate
from luxloop.loop.simulation.simulated import build_scene
from luxloop.loop.studies.training.scenes import CLASSES, HELD_OUT, TRAINING, draw, tables
from luxloop.loop.studies.training.train import mean_of
from luxloop.loop.studies.training.widening import crowd, widen_scene
from luxloop.perception.detection.network import Network
from luxloop.world.roads.base import Road
from luxloop.world.scene.body import Body


def bodies(seed: int) -> tuple[list[tuple[Body, str | None]], Road]:
    found = tables(seed)
    scenario = validate({"name": "a", "lighting": {}, **found, **crowd(found, seed)}, "a")
    scene = build_scene(scenario)
    road = scene.bodies[0].road
    return widen_scene(scenario.all_objects, road, 1.0, np.random.default_rng(seed)), road


def test_bodies_come_from_a_seed_stand_on_the_road_and_count_as_what_they_were():
    sizes = {}
    for seed in range(TRAINING, TRAINING + 4):
        found, road = bodies(seed)
        again, _ = bodies(seed)
        assert len(found) >= 8 and {category for _, category in found} & set(CLASSES) and None in {category for _, category in found}
        for (each, category), (same, _) in zip(found, again, strict=True):
            assert np.array_equal(each.mesh.vertices, same.mesh.vertices) and torch.equal(each.part_of_face, same.part_of_face)
            assert np.isfinite(each.mesh.vertices).all() and len(each.part_of_face) == len(each.mesh.faces)
            assert int(each.part_of_face.max()) < len(each.parts) and all(0 <= part.albedo <= 1 for part in each.parts)
            x, y, z = each.track.pose_at(0.0)[:3, 3].tolist()
            # axles on a bend of the road lift the middle by a few centimetres
            assert abs(z - float(road.z(np.array([x]), np.array([y]))[0])) < 0.3
            assert -0.8 < float(each.bounds[0, 2]) < 0.8
            sizes.setdefault(category, []).append((each.bounds[1] - each.bounds[0]).numpy())
    heights = [size[2] for size in sizes["pedestrian"]]
    assert min(heights) < 1.4 and 1.6 < max(heights) < 3.5
    assert max(size[0] for size in sizes["car"]) > 5.5


@pytest.mark.parametrize("seed", [HELD_OUT + 2])
def test_scenes_that_judge_have_none_of_them(seed, tmp_path):
    found = tables(seed)
    scenario = validate({"name": "a", "lighting": {}, **found}, "a")
    names = [item.kind for item in scenario.all_objects]
    ids = np.unique(np.load(tmp_path / f"{seed}.npy")[4]) if draw(seed, str(tmp_path)) else ()
    assert max(ids) <= len(names)


def test_the_mean_of_two_networks_has_the_mean_of_their_weights():
    one, other = Network(4), Network(4)
    mean = mean_of(one, other).state_dict()
    for key, value in one.state_dict().items():
        expected = (value + other.state_dict()[key]) / 2 if value.is_floating_point() else value
        torch.testing.assert_close(mean[key], expected)
