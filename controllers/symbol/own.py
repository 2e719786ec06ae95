"""A controller of the user's own, named in the scenario by `package.module:Name`."""

from importlib import import_module
from typing import Any, Final, cast

from pydantic import Field

from controllers.symbol.observer import Observer
from controllers.symbol.protocol import SymbolController
from controllers.symbol.stages import StagedParams
from world.errors import LuxloopError

OWN: Final = "package.module:Name"
METHODS = ("start", "drawing", "step")


class OwnParams(StagedParams):
    """`Name(observer, **options)` of a module that Python finds makes the controller."""

    name: str = Field(pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$", description="module and class or function, as package.module:Name")
    options: dict[str, Any] = Field({}, description="keyword arguments of Name, beside the observer")


def own_controller(params: OwnParams, observer: Observer) -> SymbolController:
    """Import and call it. Raises LuxloopError where there is none, it does not take what it is given, or lacks a method."""
    module, _, name = params.name.partition(":")
    where = f"controller.name: {params.name}"
    try:
        factory = getattr(import_module(module), name)
    except ImportError as error:
        raise LuxloopError(f"{where}: {error}; run where Python finds the module, or set PYTHONPATH") from error
    except AttributeError as error:
        raise LuxloopError(f"{where}: module {module} has no {name}; name a class or a function of it") from error
    try:
        controller = factory(observer, **params.options)
    except TypeError as error:
        raise LuxloopError(f"{where}: cannot be made with the observer and controller.options ({error})") from error
    missing = [method for method in METHODS if not callable(getattr(controller, method, None))]
    if missing:
        raise LuxloopError(f"{where}: has no method {missing[0]}; a symbol controller has {', '.join(METHODS)}")
    return cast(SymbolController, controller)
