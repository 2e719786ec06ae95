"""The file that `luxloop new` copies is what the model makes of it."""

from luxloop.loop.scenario.shipped import TEMPLATE, copy_text
from tests.loop.scenario.template import template


def test_the_template_is_that_of_the_model() -> None:
    assert TEMPLATE.read_text("utf-8") == template(), "python -m tests.loop.scenario.template"


def test_a_copy_has_its_own_name_and_keeps_what_is_said_of_it() -> None:
    assert copy_text(TEMPLATE, 'mine "1"').splitlines()[5] == 'name = "mine \\"1\\""  # name, for tables and reports'
