"""Read TOML files, and turn pydantic's errors into sentences that name the key and the remedy."""

import json
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import date, time
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from luxloop.world.errors import LuxloopError, all_of, did_you_mean, near, redact
from luxloop.world.files import content, reading
from luxloop.world.plugin import OWN, colon_remedy, tags

WANTED = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "bool_type": "true or false",
    "string_type": "a text in quotes",
    "path_type": "a path in quotes",
    "tuple_type": "a list in [brackets]",
}
TABLE_ERRORS = ("model_type", "model_attributes_type", "dict_type")
MISSING = ("missing", "union_tag_not_found")
KEY_ITSELF = "[key]"  # pydantic's location of an invalid key
INDEX = r"\[\d+\]"
TWICE = r"Cannot declare \(('.*'),?\) twice"  # tomllib's message for [header]
SHOWN_CHARACTERS = 60
HALF_TURN = 180  # deg, bound of angles that go all round
Model = TypeVar("Model", bound=BaseModel)
DEEPEST = 50  # levels of tables and lists in a file; a scenario has up to six


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file. Raises LuxloopError that names the file and the remedy."""
    with reading(path, "not valid TOML", "texts need quotes, tables a [header]"):
        data = content(path)
        try:
            return parsed_toml(data.decode("utf-8-sig"))
        except UnicodeDecodeError as error:
            raise LuxloopError(f"{path}: byte {error.start} is not UTF-8, so this is no text that can be read; save it as UTF-8") from error


def parsed_toml(text: str) -> dict[str, Any]:
    """The tables of a text. Raises ValueError with the reason if it is no TOML or not usable."""
    try:
        return _workable(lambda: tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        if (twice := re.search(TWICE, str(error))) is None:
            raise
        table = twice[1].replace("'", "").replace(", ", ".")
        raise ValueError(f"{error}: write [[{table}]] above each item of a list, and other tables once") from error


def parsed_json(text: str | bytes) -> Any:
    """The value of a text. Raises ValueError with the reason if it is no JSON or not usable."""
    return _workable(lambda: json.loads(text))


def _workable(parse: Callable[[], Any]) -> Any:
    try:
        value = parse()
    except RecursionError as error:
        raise ValueError(f"it is nested deeper than {DEEPEST} levels") from error
    if reason := _unworkable(value, DEEPEST):
        raise ValueError(reason)
    return value


def _unworkable(value: Any, levels: int) -> str:
    """Why plain data is not usable, empty if it is: too deep for recursion, integers beyond 64 bits, NUL in a text."""
    if isinstance(value, int) and value.bit_length() > 64:
        return "an integer has more than 64 bits"
    if isinstance(value, str) and "\0" in value:
        return "a text has a NUL character"
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    if inner and not levels:
        return f"it is nested deeper than {DEEPEST} levels"
    return next(filter(None, (_unworkable(each, levels - 1) for each in inner)), "")


def validate_model(model: type[Model], data: Mapping[str, Any], example: str) -> Model:
    """The model of a file's plain data. example: where to find a complete file, for those who lack a key.

    Raises LuxloopError with all errors, each with its key and remedy.
    """
    dates = dict.fromkeys(_dates(data))
    wrong = [f"{key}: is a date or a time, which has no meaning here; write a number or a text in quotes" for key in dates]
    try:
        # Through JSON, where pydantic's strict mode accepts a list for a tuple and a text for a path.
        valid = model.model_validate_json(json.dumps(data, default=str), strict=True)
    except ValidationError as error:
        wrong += [each for each in sentences(error, model, example) if each.partition(": ")[0] not in dates]
    if wrong:
        raise all_of(wrong)
    return valid


def _dates(data: Any, within: str = "") -> Iterator[str]:
    """Keys whose values are dates or times, which TOML has and JSON has not."""
    if isinstance(data, date | time):
        yield within
    elif isinstance(data, Mapping):
        for key, value in data.items():
            yield from _dates(value, f"{within}.{key}".strip("."))
    elif isinstance(data, list | tuple):
        for k, value in enumerate(data):
            yield from _dates(value, f"{within}[{k}]")


def toml(value: Any) -> str:
    """A value as TOML on one line, without keys that are None, which TOML cannot write."""
    if isinstance(value, BaseModel | dict):
        items = value.items() if isinstance(value, dict) else value
        return "{" + ", ".join(f"{key} = {toml(inner)}" for key, inner in items if inner is not None) + "}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml, value))}]"
    return json.dumps(value, ensure_ascii=False)


def sentences(error: ValidationError, model: type[BaseModel], example: str) -> list[str]:
    """All errors, a sentence each, unknown keys first. example: as in `validated`, for the first key that is missing.

    Consequences of other errors are left out: a list too short without its invalid items, a missing key that is misspelt, a default that
    depends on invalid values.
    """
    details = [each for each in error.errors(include_url=False) if each["type"] != "default_factory_not_called"]
    unknown = [each["loc"] for each in details if each["type"] == "extra_forbidden"]
    caused: dict[str, set[Any]] = {
        "too_short": {each["loc"][:k] for each in details for k in range(len(each["loc"]))},
        "missing": {(*place[:-1], near(str(place[-1]), _place(model, place)[1])) for place in unknown},
    }
    own = [each for each in details if each["loc"] not in caused.get(each["type"], ())]
    lacking = next((each for each in own if each["type"] in MISSING), None)
    ordered = sorted(own, key=lambda each: each["type"] != "extra_forbidden")
    return [_sentence(each, model, f" ({example})" if each is lacking else "") for each in ordered]


def _sentence(detail: Any, model: type[BaseModel], example: str) -> str:
    key, fields, variants = _place(model, detail["loc"])
    if detail["type"].startswith("union_tag") and isinstance(detail["input"], dict):
        key = f"{key}.{_discriminator(detail)}"
    what = f"is missing; {_remedy(detail, fields, variants)}{example}" if _is_missing(detail) else _what(detail, key, fields, variants)
    return f"{key}: {what}" if key else what


def _is_missing(detail: Any) -> bool:
    return detail["type"] in MISSING and (detail["type"] == "missing" or isinstance(detail["input"], dict))


def _remedy(detail: Any, fields: Mapping[str, FieldInfo], variants: Iterable[type[BaseModel]]) -> str:
    """The remedy for a missing key or a missing tag of a union."""
    if detail["type"] != "missing":
        first, *others = (tag for variant in variants for tag in tags(variant))
        return f"write {_discriminator(detail)} = {toml(first)}, or one of {', '.join(others)}"
    key = [part for part in detail["loc"] if isinstance(part, str)][-1]
    field = fields.get(key)
    written = f"write {key} = {toml(field.examples[0])}, say" if field and field.examples else "add it"
    return f"{written}: {field.description}" if field and field.description else written


def _what(detail: Any, key: str, fields: dict[str, FieldInfo], variants: Iterable[type[BaseModel]]) -> str:
    """The error in words. key: as a file writes it; fields: of its table; variants: models allowed there."""
    kind, given, context = detail["type"], detail.get("input"), detail.get("ctx", {})
    table = re.sub(INDEX, "", key)
    name = table.rpartition(".")[2]
    if kind == "extra_forbidden":
        inner = [each for each, field in fields.items() if any(name in model.model_fields for model in _models(field.annotation))]
        if len(inner) == 1 and not near(name, fields):
            return f"unknown key; write {inner[0]} = {toml({name: given})}"
        return f"unknown key; {did_you_mean(name, fields)}"
    if kind in (*TABLE_ERRORS, "union_tag_not_found"):
        meant = (each for model in variants for each, field in model.model_fields.items() if given in get_args(field.annotation))
        written = next((f"{name} = {toml({each: given})}" for each in meant), "key = value below a [header]")
        return f"{_value_text(given)} is no table of keys; write {written}"
    if kind == "tuple_type" and isinstance(given, dict):
        return f"is one table, but a list of them is wanted; write [[{table}]] above each"
    if kind == "union_tag_invalid":
        known = _names_in(context["expected_tags"])
        remedy = colon_remedy(context["tag"]) if OWN in known else None
        return f"there is no {context['tag']!r}; {remedy or did_you_mean(context['tag'], known)}"
    if kind == "literal_error":
        expected = context["expected"].replace(" or ", ", ")
        return f"{_value_text(given)} is not possible; {did_you_mean(str(given), _names_in(expected), f'give one of {expected}')}"
    if kind in WANTED:
        quotes = "; the shell took its quotes, put all of key=value into single ones" if str(given).startswith("[") else ""
        return f"{_value_text(given)} is not {WANTED[kind]}{quotes}"
    if kind == "value_error":
        return str(context["error"])
    message = detail["msg"]
    for subject in ("Input ", "String ", "Tuple "):
        message = message.removeprefix(subject)
    turn = (
        f"; write {(given + 180) % 360 - 180:g}"
        if name.endswith("_deg") and HALF_TURN in (context.get("le"), -context.get("ge", 0))
        else ""
    )
    return f"{_value_text(given)} {message.replace(' after validation', '')}{turn}"


def _value_text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "a table"
    text = redact(repr(value))
    return text if len(text) <= SHOWN_CHARACTERS else f"{text[:SHOWN_CHARACTERS]}..."


def _discriminator(detail: Any) -> str:
    return str(detail["ctx"]["discriminator"]).strip("'()")


def _names_in(names: str) -> list[str]:
    return [name.strip(" '") for name in names.split(",")]


def _place(model: type[BaseModel], location: tuple[int | str, ...]) -> tuple[str, dict[str, FieldInfo], list[type[BaseModel]]]:
    """Follow an error's location through the model: the key as a file writes it, the fields of the table that it lies in, and the models
    that may stand there."""
    key = ""
    candidates, named = [model], False
    fields: dict[str, FieldInfo] = {}
    for part in (part for part in location if part != KEY_ITSELF):
        chosen = [candidate for candidate in candidates if len(candidates) > 1 and part in tags(candidate)]
        if isinstance(part, int):
            key += f"[{part}]"
        elif named:  # a table by a name that the file chooses
            key, named = f"{key}.{part}", False
        elif chosen:  # a variant's tag, which the file does not write here
            candidates = chosen
        else:
            key = f"{key}.{part}" if key else part
            fields = {name: field for candidate in candidates for name, field in candidate.model_fields.items()}
            candidates = list(_models(fields[part].annotation)) if part in fields else []
            named = part in fields and get_origin(fields[part].annotation) is Mapping
    return key, fields, candidates


def _models(annotation: Any) -> Iterable[type[BaseModel]]:
    """All models that a field may hold, itself or in a list or union."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models(argument)
