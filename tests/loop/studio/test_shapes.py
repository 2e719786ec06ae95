"""Meshes of bodies: each is made once, and those that nobody has seen for long are forgotten."""

import pytest
import torch
import trimesh

from luxloop.loop.studio import shapes
from luxloop.loop.studio.shapes import Shapes
from luxloop.world.scene.body import Body
from luxloop.world.scene.triangles import Instance


def placed(name: str) -> Instance:
    return Instance(1, Body(name, trimesh.creation.box(), 0.5), torch.eye(4, dtype=torch.float64))


def test_the_mesh_not_seen_for_longest_is_forgotten_and_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    made, (a, b, c) = Shapes(), [placed(name) for name in "abc"]
    ((first, _),) = made.numbered([a])
    monkeypatch.setattr(shapes, "KEPT_BYTES", 2 * sum(each.nbytes for each in made.meshes[first][1].values()))
    for step in ([a, b], [a], [c]):
        made.numbered(step)
    assert made.meshes.keys() == {first, first + 2}  # the second one was seen before the first
    assert made.numbered([b])[0][0] == first + 1 and made.meshes.keys() == {first + 1, first + 2}


def test_all_meshes_of_a_step_are_there_however_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shapes, "KEPT_BYTES", 1)
    made, bodies = Shapes(), [placed(name) for name in "abc"]
    made.numbered([placed("old")])
    assert [number for number, _ in made.numbered(bodies)] == [*made.meshes]
