"""User-defined parts, named in scenarios by `package.module:Name`: import, trust, construction, and their errors as one sentence."""

import os
import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from importlib import import_module
from importlib.machinery import PathFinder
from inspect import Parameter, signature
from pathlib import Path
from traceback import walk_tb
from typing import Annotated, Any, Final, get_args

from pydantic import BaseModel, Field, GetCoreSchemaHandler, ValidationError
from pydantic_core.core_schema import CoreSchema, no_info_after_validator_function, str_schema, tagged_union_schema

from luxloop.world.errors import MOST_ERRORS, LuxloopError, all_of, did_you_mean, near
from luxloop.world.params import Params

OWN: Final = "package.module:Name"
PATTERN: Final = r"^(.*/)?[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*$"
PACKAGE: Final = "__init__.py"


class Name(str):
    """`package.module:Name` in a scenario; `folder/package.module:Name` where the module lies in that folder.

    Only values of this type are imported, and `refuse_code` finds them all.
    """

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return no_info_after_validator_function(cls, str_schema(pattern=PATTERN))

    @property
    def folder(self) -> Path | None:
        """None where the module is one that Python finds."""
        folder, slash, _ = self.rpartition("/")
        return Path(folder or slash) if slash else None

    @property
    def module(self) -> str:
        return self.rpartition("/")[2].partition(":")[0]

    @property
    def attribute(self) -> str:
        return self.rpartition(":")[2]


OwnName = Annotated[Name, Field(description="module and class, as package.module:Name")]


class OwnPart(Params):
    """A part of a user's module: `Name(*given, **options)`, with arguments given by luxloop first."""

    kind: OwnName
    options: dict[str, Any] = Field({}, description="keyword arguments of Name")


@dataclass(frozen=True)
class KnownOrOwn:
    """Discriminates a union by a key; all values `package.module:Name` have the tag `OWN`."""

    key: str
    default: str | None = None

    def __get_pydantic_core_schema__(self, union: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        def tag(table: Any) -> Any:
            given = table.get(self.key, self.default) if isinstance(table, dict) else getattr(table, self.key, None)
            return OWN if isinstance(given, str) and ":" in given else given

        tag.__name__ = self.key  # the name in pydantic's errors
        return tagged_union_schema({name: handler.generate_schema(model) for name, model in by_tag(union).items()}, tag)


def by_tag(union: Any) -> dict[str, Any]:
    """The models of a union by tag: their `kind` or `name`; a user-defined one has the tag `OWN`."""
    return {name: model for model in get_args(union) for name in tags(model)}


def tags(model: type[BaseModel]) -> tuple[Any, ...]:
    """The tags of a model in a union, none if it has neither `kind` nor `name`."""
    field = model.model_fields.get("kind") or model.model_fields.get("name")
    return () if field is None else get_args(field.annotation) or (OWN,)


def colon_remedy(text: str) -> str | None:
    """What to write in place of a name with a dot for its colon; None of other texts, such as a file's name."""
    meant = ":".join(text.rsplit(".", 1))
    return f"write {meant}, with a colon before the class" if re.fullmatch(PATTERN, meant) and not text.endswith(".py") else None


def file_of(folder: Path, module: str) -> Path | None:
    """The file of a module in a folder, None where it has none there."""
    path = folder.joinpath(*module.split("."))
    return next((file for file in (path / PACKAGE, path.with_name(f"{path.name}.py")) if os.path.isfile(file)), None)


def beside(text: str, folder: Path) -> str:
    """A name with an absolute folder if its module lies in the folder, or its own folder is relative to that; other texts as they are."""
    if not re.fullmatch(PATTERN, text):
        return text
    name = Name(text)
    place = (folder / (name.folder or "")).resolve()
    found = name.folder is not None or file_of(place, name.module) is not None
    return f"{place}/{name.module}:{name.attribute}" if found else text


def own_names(params: Any, key: str = "") -> Iterator[tuple[str, Name]]:
    """All user-defined modules that a model names, with their keys."""
    if isinstance(params, Name):
        yield key, params
    elif isinstance(params, BaseModel):
        for field, value in params:
            yield from own_names(value, f"{key}.{field}".strip("."))
    elif isinstance(params, Mapping):
        for name, value in params.items():
            yield from own_names(value, f"{key}.{name}")
    elif isinstance(params, tuple):
        for k, value in enumerate(params):
            yield from own_names(value, f"{key}[{k}]")


def refuse_code(params: BaseModel, source: str, typed: Collection[str] = ()) -> None:
    """Raises LuxloopError where a model that was read from a file names a module, for a file must not run code unless the user says so.

    source: the file, for the message. typed: names that the user gave beside the file, which are trusted.
    """
    if found := [(key, name) for key, name in own_names(params) if name not in typed]:
        modules = list(dict.fromkeys(name.module for _, name in found))
        several = "s" if len(modules) > 1 else ""
        raise LuxloopError(
            f"{source}: {', '.join(f'{key}: {name}' for key, name in found)} would run the module{several} {', '.join(modules)}; "
            f"give --allow-code (in Python allow_code=True) if you trust the file and the module{several}"
        )


def load(name: Name, key: str, methods: Sequence[str]) -> Any:
    """The class `package.module:Name`. key: the scenario's key that names it, for messages.

    The name's folder stays on the path that Python searches, since a module may import from beside itself whenever it runs; at the end,
    so that nothing in it takes the place of another module.

    Raises LuxloopError where there is no such module, it fails while it is imported, it has no such class, or that lacks a method.
    """
    where = f"{key}: {name}"
    if name.folder is not None and str(name.folder) not in sys.path:
        sys.path.append(str(name.folder))
    with running(name, key, f"importing {name.module}"):
        try:
            module = import_module(name.module)
        except ModuleNotFoundError as error:
            if error.name is None or not f"{name.module}.".startswith(f"{error.name}."):
                raise
            remedy = "put it beside the file that names it, run where Python finds it, or set PYTHONPATH to its folder"
            raise LuxloopError(f"{where}: {error}; {remedy}") from error
    file = None if name.folder is None else file_of(name.folder, name.module)
    if file is not None and file.resolve() != Path(str(module.__file__)).resolve():
        raise LuxloopError(f"{where}: Python knows another module of this name, {module.__file__}; rename {file}")
    found = getattr(module, name.attribute, None)
    if not isinstance(found, type):
        what = f"module {name.module} has no {name.attribute}" if found is None else f"{name.attribute} is no class"
        classes = [each for each, of in vars(module).items() if isinstance(of, type) and of.__module__ == module.__name__]
        raise LuxloopError(f"{where}: {what}; {did_you_mean(name.attribute, classes) if classes else 'name a class of it'}")
    check_methods(found, where, methods)
    return found


def check_methods(made_by: type, where: str, methods: Sequence[str]) -> None:
    """Raises LuxloopError where a class lacks one of the methods; where: what messages begin with."""
    if missing := [method for method in methods if not callable(getattr(made_by, method, None))]:
        raise LuxloopError(f"{where}: has no method {missing[0]}; it needs {', '.join(methods)}")


def make(name: Name, key: str, given: Mapping[str, Any], options: Mapping[str, Any], methods: Sequence[str]) -> Any:
    """`Name(*given, **options)`, checked for its methods. given: luxloop's arguments, by their names in messages.

    key: that of the scenario which names it; `options` stands beside it. Raises as `load` does, and LuxloopError where an option is unknown
    or missing, or the construction fails.
    """
    return construct(load(name, key, methods), name, key, given, options)


def construct(made_by: type, name: Name, key: str, given: Mapping[str, Any], options: Mapping[str, Any]) -> Any:
    """As `make`, for a loaded class."""
    table = f"{key.rpartition('.')[0]}.options".removeprefix(".")
    _fitting(made_by, name, table, tuple(given.values()), options)
    with running(name, key, f"__init__ with {' and '.join([*(f'the {each}' for each in given), table])}"):
        return Guard(made_by(*given.values(), **options), name, key)


@dataclass(frozen=True)
class Guard:
    """A user-defined part whose failing methods raise LuxloopError with file and line."""

    part: Any
    name: Name
    key: str

    def __getattr__(self, attribute: str) -> Any:
        if attribute.startswith("__"):  # copy and pickle ask for these before the part is set
            raise AttributeError(attribute)
        found = getattr(self.part, attribute)
        return self._guard(found) if callable(found) else found

    def _guard(self, method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)
        def call(*arguments: Any, **keywords: Any) -> Any:
            with running(self.name, self.key, method.__name__):
                result = method(*arguments, **keywords)
            return Guard(result, self.name, self.key) if isinstance(result, type(self.part)) else result

        return call


@contextmanager
def running(name: Name, key: str, what: str) -> Iterator[None]:
    """Turn exceptions of user code into a LuxloopError with its file and line."""
    try:
        yield
    except LuxloopError:
        raise
    except Exception as error:
        raise LuxloopError(f"{key}: {name}: {what} fails{_place(error, name)} ({in_a_line(error)})") from error


def _place(error: Exception, name: Name) -> str:
    """File and line of the innermost call in the module, its package, or the files beside it; empty where there is none."""
    top = name.module.partition(".")[0]
    path = None if name.folder is None else [str(name.folder)]
    spec = getattr(sys.modules.get(top), "__spec__", None) or PathFinder.find_spec(top, path)  # None of the main program
    packages = [Path(folder) for folder in (spec and spec.submodule_search_locations) or ()]
    folder = Path(spec.origin).parent if spec and spec.origin and not packages else None
    for frame, line in reversed([*walk_tb(error.__traceback__)]):
        file = Path(frame.f_code.co_filename)
        mine = frame.f_globals.get("__name__") == name.module
        if mine or file.parent == folder or any(file.is_relative_to(package) for package in packages):
            return f" at {file}, line {line}"
    return ""


def _fitting(made_by: Callable[..., Any], name: str, table: str, given: Sequence[Any], options: Mapping[str, Any]) -> None:
    """Raises LuxloopError where options do not fit the signature of `Name`, as far as it has one."""
    if isinstance(made_by, type) and issubclass(made_by, BaseModel):
        made_by.model_rebuild()  # a model that is not built yet has no signature of its own
    try:
        takes = signature(made_by)
        filled = takes.bind_partial(*given).arguments
    except (TypeError, ValueError):
        return
    left = [each for key, each in takes.parameters.items() if key not in filled]
    if any(each.kind == Parameter.VAR_KEYWORD for each in left):
        return
    known = [each.name for each in left if each.kind in (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)]
    strange = [key for key in options if key not in known]
    here = {*options, *(near(key, known) for key in strange)}
    lacking = [each.name for each in left if each.default is Parameter.empty and each.name in known and each.name not in here]
    wrong = [
        f"{table}.{key}: {name} has no option of this name; {did_you_mean(key, known) if known else 'leave it out, for it takes none'}"
        for key in strange
    ]
    wrong += [f"{table}.{key}: is missing, and {name} has no default for it; add it" for key in lacking]
    texts = {each.name: options[each.name] for each in left if _takes_number(each) and isinstance(options.get(each.name), str)}
    wrong += [f"{table}.{key}: is the text {text!r}; write {_number_in(text) or 'a number'}" for key, text in texts.items()]
    if wrong:
        raise all_of(wrong)


def _takes_number(parameter: Parameter) -> bool:
    """Whether its default or its annotation is a number, and the annotation no text as well."""
    kinds = (parameter.annotation, *get_args(parameter.annotation))
    return str not in kinds and (type(parameter.default) in (int, float) or any(each in (int, float, "int", "float") for each in kinds))


def _number_in(text: str) -> str:
    """The number of a text with a decimal comma, as TOML writes it; empty where it is none."""
    number = text.replace(",", ".")
    return number if re.fullmatch(r"[+-]?\d+(\.\d+)?", number) else ""


def in_a_line(error: Exception) -> str:
    """An error's text for the end of a sentence."""
    if isinstance(error, ValidationError):
        return "; ".join(f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors(include_url=False)[:MOST_ERRORS])
    return " ".join(f"{type(error).__name__}: {error}".split())
