"""The loop as a whole, on a road whose shape the controller is right about."""

from loop.scenario import Scenario, StartParams
from loop.simulation import Simulation


def test_the_controller_knows_that_the_road_is_wet(small_scenario: Scenario) -> None:
    surface = small_scenario.surface.model_copy(update={"wet": 1.0})
    wet = small_scenario.model_copy(update={"surface": surface, "start": StartParams(), "steps": 6})
    verdicts = [result.verdict for result in Simulation.prepare(wet).run()]
    # At the target light and model agree; noise moves the symbol by a few centimetres then. A model of a dry road has 0.6 throughout.
    assert verdicts[0].iou > 0.98
    assert min(float(verdict.iou) for verdict in verdicts) > 0.85 and verdicts[-1].iou > 0.9
