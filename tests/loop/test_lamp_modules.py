"""Modules of a description that would be dark are refused, whatever their light is to come from."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loop.lamp_modules import ModuleParams, build_module
from world.errors import LuxloopError
from world.photometry import Distribution, write

ASIDE = {"left_deg": 40, "right_deg": 30}
RECTANGLES = {
    **{"kind": "blurred_rectangles", "rows": 2, "columns": 4, "left_deg": 8, "right_deg": -8, "bottom_deg": -3, "top_deg": 3},
    **{"blur_deg": 0.3, "peak_cd": 1000},
}
GAUSSIAN = {
    **{"kind": "gaussian", "columns": 3, "left_deg": 5, "right_deg": -5, "row_centres_deg": [0], "row_sigmas_deg": [1]},
    **{"column_sigma": 0.5, "peak_cd": [1000]},
}


def refusal(folder: Path, **module: Any) -> str:
    with pytest.raises(LuxloopError) as error:
        build_module(ModuleParams.model_validate({"name": "m", **module}), folder, lambda *_: [])
    return str(error.value)


@pytest.mark.parametrize(
    "module",
    [
        {"source": RECTANGLES | {"peak_cd": 0}},
        {"source": GAUSSIAN | {"peak_cd": [0]}},
        {"source": RECTANGLES, "texture": ASIDE},
        {"source": GAUSSIAN, "texture": ASIDE},
    ],
)
def test_a_model_without_light_on_its_texture_is_refused(tmp_path: Path, module: dict[str, Any]) -> None:
    assert "lights no texel of the texture" in refusal(tmp_path, **module)


def test_measured_pixels_beside_their_texture_are_refused(tmp_path: Path) -> None:
    angles = np.array([-2.0, 0, 2])
    write(tmp_path / "p.ies", Distribution("A", angles, angles, np.outer([0, 1, 0], [0, 500.0, 0])))
    assert "no pixel shines onto the texture" in refusal(tmp_path, source={"kind": "file", "path": "p.ies"}, texture=ASIDE)


def test_a_bound_above_all_light_is_refused(tmp_path: Path) -> None:
    assert "bound_cd = 1e+06 leaves no light" in refusal(tmp_path, source=RECTANGLES, overlap={"bound_cd": 1e6})
