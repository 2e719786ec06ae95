"""Extractions of the user's own: the whole symbol loop looks with them, and what is wrong is said in a sentence."""

from typing import Any

import pytest
import torch
from torch import Tensor

from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.extraction import ExtractionParams, OwnExtractionParams, symbol_image
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import simulation_of
from tests.refusal import sentence

OWN = """
import torch
from luxloop.perception import extraction

class Ours:
    def __init__(self, edges="grey"):
        self.params = extraction.ExtractionParams(edges=edges)
    def symbol_image(self, contrast, limit):
        return extraction.symbol_image(contrast, limit, self.params)

class Pooled(Ours):
    def symbol_image(self, contrast, limit):
        return contrast[..., ::2, ::2]

class Elsewhere(Ours):
    def symbol_image(self, contrast, limit):
        return contrast.to("meta")

class Blind:
    pass
"""
SMALL = [f"headlight.model={SMALL_LAMP}", "camera.width_px=320", "camera.height_px=180", "camera.oversampling=2"]


def looked(*overrides: Any) -> tuple[Simulation, Tensor]:
    """Errors of three steps on bumps."""
    simulation = simulation_of(load("flat", [*SMALL, "road.kind=bumps", *overrides], steps=3))
    return simulation, torch.stack([result.symbol.measurement.errors for result in simulation.evaluations()])


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize("controller", ["luxloop", "model_reference"])
def test_the_loop_looks_with_it(controller: str) -> None:
    """Ours by another name sees, expects and registers the same, bit for bit; other edges do not."""
    named = f"functions.symbol.controller.name={controller}"
    own = "functions.symbol.extraction={kind='own:Ours', options={edges='binary'}, area_low=0.3}"
    _, as_own = looked(named, own)
    simulation, as_ours = looked(named, "functions.symbol.extraction={edges='binary', area_low=0.3}")
    _, by_default = looked(named, "functions.symbol.extraction.area_low=0.3")
    assert torch.equal(as_own, as_ours) and not torch.equal(as_own, by_default)
    assert isinstance(simulation.scenario.symbol.extraction, ExtractionParams)
    scenario = load("flat", [own])
    assert type(scenario).model_validate_json(scenario.model_dump_json()) == scenario, "recordings hold it"


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(
    ("extraction", "words"),
    [
        ({"kind": "own:Ours", "options": {"edge": "grey"}}, ["functions.symbol: extraction.options", "edge"]),
        ({"kind": "own:Blind"}, ["no method symbol_image"]),
        ({"kind": "own:Pooled"}, ["float32", "an image like that"]),
        ({"kind": "own:Elsewhere"}, ["on meta for", "on cpu"]),
    ],
)
def test_what_is_wrong_with_it_is_said_in_a_sentence(extraction: dict[str, Any], words: list[str]) -> None:
    with sentence("extraction", *words):
        looked({"functions": {"symbol": {"extraction": extraction}}})


def test_batches_and_devices_are_passed_on(device: torch.device) -> None:
    own = OwnExtractionParams(kind=f"{__name__}:Lit")
    contrast, limit = torch.rand(2, 3, 8, 6, device=device), torch.full((8, 6), 0.4, device=device)
    assert symbol_image(contrast, limit, own).equal((contrast > limit).to(contrast))


class Lit:
    def symbol_image(self, contrast: Tensor, limit: Tensor) -> Tensor:
        return (contrast > limit).to(contrast)
