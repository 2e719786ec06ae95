"""Closed loops around HD matrix headlights: simulate the lamp, the road and the camera, and control the light from what the camera sees.

    import luxloop

    result = luxloop.run("snowflake")
    print(result.summary["functions"]["symbol"]["iou_final"])

A notebook shows `result` as the report of the run. What is named here is the public interface; the insides of `world`, `perception`,
`controllers` and `loop` may change. Names are imported when they are first used.
"""

from typing import Any

import lazy_loader

_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from luxloop.world.files import installed_version

        return installed_version()
    if name in __all__:
        return _attribute(name)
    from luxloop.world.errors import did_you_mean

    raise AttributeError(f"module 'luxloop' has no attribute {name!r}; {did_you_mean(name, __all__)}")
