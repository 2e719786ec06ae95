"""Meshes of bodies: each is made once, and those that nobody has seen for long are forgotten."""

import torch
import trimesh

from luxloop.loop.studio import meshes
from luxloop.loop.studio.meshes import Meshes
from luxloop.world.scene.body import Body
from luxloop.world.scene.triangles import Instance


def placed(name: str) -> Instance:
    return Instance(1, Body(name, trimesh.creation.box(), 0.5), torch.eye(4, dtype=torch.float64))


def test_the_mesh_not_seen_for_longest_is_forgotten_and_made_again(monkeypatch):
    made, (a, b, c) = Meshes(), [placed(name) for name in "abc"]
    ((first, _),) = made.assign([a])
    monkeypatch.setattr(meshes, "KEPT_BYTES", 2 * sum(each.nbytes for each in made.of[first][1].values()))
    for step in ([a, b], [a], [c]):
        made.assign(step)
    assert made.of.keys() == {first, first + 2}  # the second one was seen before the first
    assert made.assign([b])[0][0] == first + 1 and made.of.keys() == {first + 1, first + 2}


def test_all_meshes_of_a_step_are_there_however_large(monkeypatch):
    monkeypatch.setattr(meshes, "KEPT_BYTES", 1)
    made, bodies = Meshes(), [placed(name) for name in "abc"]
    made.assign([placed("old")])
    assert [number for number, _ in made.assign(bodies)] == [*made.of]
