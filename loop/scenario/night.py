"""A night with traffic, road and light drawn from a seed, as a scenario file for `luxloop new`."""

from typing import Final

from luxloop.world.traffic.generator import random_tables
from luxloop.world.validation import toml

HEAD: Final = """\
# A night on the road, drawn from a seed. Check it with `luxloop check FILE`, run it with `luxloop run FILE`.
# Another traffic.seed: others elsewhere. Add your own objects as [[objects]].

schema_version = 1
"""


def night(name: str, seed: int) -> str:
    """The text of a scenario of lighting functions with traffic, road and light drawn from a seed."""
    world = random_tables(seed)
    tables = {
        **world,
        "traffic": world["traffic"] | {"on_road": True},
        "camera": {"width_px": 960, "height_px": 400, "hfov_deg": 30.0, "pitch_deg": 1.5},
        "headlight": {"model": "ssl-hd-lores"},
        "lighting": {"base": {"beam": "low"}},
        "functions.guard_traffic": {"kind": "glare_free"},
    }
    lines = [f"name = {toml(name)}", "steps = 40", "rate_hz = 20"]
    for key, table in tables.items():
        lines += ["", f"[{key}]", *(f"{inner} = {toml(value)}" for inner, value in table.items())]
    return HEAD + "\n".join(lines) + "\n"
