"""The memory of a simulation, hundreds of megabytes, is free when nobody uses it: Python's own collections count objects, not bytes."""

import gc
import weakref

import pytest

from luxloop import Simulation, validate
from tests.loop.conftest import SMALL

SYMBOL = SMALL["functions"]["symbol"] | {"controller": "luxloop"}


@pytest.mark.parametrize("vehicle", [None, {"course": [{"speed_m_s": 10.0}]}], ids=["stands", "drives"])
def test_a_simulation_goes_with_its_last_user(vehicle):
    simulation = Simulation.prepare(validate(SMALL | {"vehicle": vehicle, "functions": {"symbol": SYMBOL}}, "freed"))
    state = simulation.start()
    for _ in range(2):
        state, result = simulation.step(state)
    parts = (simulation.world, simulation.world.scene.bodies[0], simulation.modules[0].controller, simulation.symbol.controller)
    gone = [weakref.ref(each) for each in parts]
    gc.collect()
    gc.disable()
    try:
        del simulation, state, result, parts
        assert [each() for each in gone] == [None] * len(gone)
    finally:
        gc.enable()
