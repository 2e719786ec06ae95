"""Meshes of bodies: each is made once, and those that nobody has seen for long are forgotten."""

import pytest
import torch
import trimesh

from loop.studio import shapes
from loop.studio.shapes import Shapes
from world.scene.body import Body
from world.scene.triangles import Placed


def placed(name: str) -> Placed:
    return Placed(1, Body(name, trimesh.creation.box(), 0.5), torch.eye(4, dtype=torch.float64))


def test_the_mesh_not_seen_for_longest_is_forgotten_and_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    made, bodies = Shapes(), [placed(name) for name in "abc"]
    number = made.number(bodies[0])
    size = sum(each.nbytes for each in made.meshes[number][1].values())
    monkeypatch.setattr(shapes, "KEPT_BYTES", 2 * size)
    numbers = [made.number(each) for each in bodies[:2]]
    assert numbers == [number, number + 1] and made.number(bodies[0]) == number
    assert made.number(bodies[2]) == number + 2 and made.meshes.keys() == {number, number + 2}  # the second one was seen before the first
    assert made.number(bodies[1]) == number + 1 and made.meshes.keys() == {number + 1, number + 2}


def test_a_mesh_larger_than_all_that_is_kept_is_there_while_it_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shapes, "KEPT_BYTES", 1)
    made, one = Shapes(), placed("one")
    assert made.number(one) in made.meshes
