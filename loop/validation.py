"""From pydantic's errors to one sentence that names the key and the remedy."""

import difflib
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError


def sentence(error: ValidationError, model: type[BaseModel]) -> str:
    """The first thing wrong, in a sentence; unknown keys come first, since a typo also makes its key seem missing."""
    details = sorted(error.errors(), key=lambda detail: detail["type"] != "extra_forbidden")
    detail = details[0]
    fields, location = _walk(model, detail["loc"])
    key = ".".join(location) or "the scenario"
    more = f" ({len(details) - 1} more after this)" if len(details) > 1 else ""
    return f"{key}: {_what(detail, fields)}{more}"


def _what(detail: Any, fields: dict[str, Any]) -> str:
    kind, given = detail["type"], detail.get("input")
    if kind == "extra_forbidden":
        name = str(detail["loc"][-1])
        nearest = difflib.get_close_matches(name, fields, 1, 0.5)
        return f"unknown key; did you mean {nearest[0]!r}?" if nearest else f"unknown key; known are {', '.join(fields)}"
    if kind == "missing":
        return "is missing; add it (`luxloop new FILE` writes a complete example)"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        context = detail.get("ctx", {})
        tag = context.get("discriminator", "'kind'").strip("'")
        expected = [name.strip(" '") for name in str(context.get("expected_tags", "")).split(",") if name.strip(" '")]
        if kind == "union_tag_not_found":
            return f"the key {tag!r} is missing; say which kind this is"
        nearest = difflib.get_close_matches(str(context.get("tag")), expected, 1, 0.5)
        hint = f"did you mean {nearest[0]!r}?" if nearest else f"known are {', '.join(expected)}"
        return f"there is no {tag} {context.get('tag')!r}; {hint}"
    if kind == "literal_error":
        expected = [part.strip(" '") for part in detail["ctx"]["expected"].replace(" or ", ", ").split(",")]
        nearest = difflib.get_close_matches(str(given), expected, 1, 0.5)
        hint = f"; did you mean {nearest[0]!r}?" if nearest else ""
        return f"{given!r} is not possible, give one of {', '.join(expected)}{hint}"
    message = detail["msg"].removeprefix("Value error, ").removeprefix("Input ")
    shown = "" if isinstance(given, dict | list) else f"{given!r} "
    return f"{shown}{message}"


def _walk(model: type[BaseModel], loc: tuple[int | str, ...]) -> tuple[dict[str, Any], list[str]]:
    """Follow an error's location through the model: the fields of the innermost table, and the location without tags of variants."""
    current: Any = model
    fields: dict[str, Any] = model.model_fields
    names: list[str] = []
    for part in loc:
        if isinstance(part, int):
            names.append(f"{names.pop()}[{part}]" if names else f"[{part}]")
            continue
        variant = next((m for m in _models(current) if _tag(m) == part), None)
        if variant is not None and part not in fields:
            fields, current = variant.model_fields, variant
            continue
        names.append(part)
        if part in fields and part is not loc[-1]:
            current = fields[part].annotation
            inner = _models(current)
            fields = inner[0].model_fields if len(inner) == 1 else {}
    return fields, names


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) is None:
        return []
    return [found for argument in get_args(annotation) for found in _models(argument)]


def _tag(model: type[BaseModel]) -> str | None:
    field = model.model_fields.get("kind") or model.model_fields.get("name")
    return field.default if field is not None and isinstance(field.default, str) else None
