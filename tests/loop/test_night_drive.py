"""The drive that shows everything at once: it runs, and in full length its checks come out as its page says."""

import pytest

from luxloop import load, run
from luxloop.loop.recording.record import row
from tests.loop.conftest import simulation_of


def test_it_runs_with_all_that_it_shows():
    scenario = load("night_drive", ["camera.width_px=160", "camera.height_px=90"], steps=2)
    assert scenario.steps / scenario.rate_hz < 1 <= load("night_drive").steps / load("night_drive").rate_hz / 12
    kinds = {function.kind for function in scenario.functions.values()}
    assert kinds == {"glare_free", "object_based", "symbol", "path", "lane"} and tuple(scenario.symbols) == ("way",)
    first, second = (row(result) for result in simulation_of(scenario).evaluations())
    assert first["base_share"] == 1 and first["functions.way.iou"] > 0.5 and second["flux_lm"] > 100


@pytest.mark.slow
def test_its_checks_come_out_as_its_page_says(tmp_path):
    checks = run("night_drive", tmp_path, device="cpu", video=False, report=False, checks=True).summary["checks"]
    assert len(checks) == 7 and all(each["passed"] for each in checks.values())
