"""Types of the studio's page, `studio/src/protocol.ts`, from the messages in Python: `python scripts/protocol.py`."""

from collections.abc import Mapping
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NotRequired, Union, get_args, get_origin

from studio_answers import ANSWERS, PARTS

from luxloop.loop.studio.messages import Message, View

FILE = Path(__file__).parents[1] / "studio/src/protocol.ts"
PLAIN = {int: "number", float: "number", str: "string", bool: "boolean", NoneType: "null", Any: "unknown"}


def typescript() -> str:
    """The text of the file."""
    answers = {f"{name.title()}Message": {"type": Literal[name]} | dict(fields) for name, fields in ANSWERS.items()}
    asks = {
        f"{each.__name__.removeprefix('Ask')}Request": {
            name: field.annotation if field.is_required() else NotRequired[field.annotation] for name, field in each.model_fields.items()
        }
        for each in get_args(Message)
    }
    return "\n\n".join(
        [
            "// Made from the messages in Python by scripts/protocol.py.",
            f"export type View = {_type(View)};",
            *(f"export interface {name} {_table(fields)}" for name, fields in {**PARTS, **answers, **asks}.items()),
            f"export type ServerMessage = {' | '.join(answers)};",
            f"export type ClientMessage = {' | '.join(asks)};\n",
        ]
    )


def _table(fields: Mapping[str, Any]) -> str:
    lines = ((name, get_args(of)[0], "?") if get_origin(of) is NotRequired else (name, of, "") for name, of in fields.items())
    return "\n".join(["{", *(f"  {name}{optional}: {_type(of)};" for name, of, optional in lines), "}"])


def _type(of: Any) -> str:
    """A type of TypeScript."""
    if isinstance(of, list | tuple | dict):  # of tables in PARTS
        each = [_type(one) for one in (of.values() if isinstance(of, dict) else of)]
        if isinstance(of, list):
            return f"({each[0]})[]" if " | " in each[0] else f"{each[0]}[]"
        return f"Record<string, {each[0]}>" if isinstance(of, dict) else " | ".join(each)
    if of is None or of in PARTS:
        return of or "null"
    kind, args = get_origin(of), get_args(of)
    if kind is Literal:
        return " | ".join(f'"{each}"' for each in args)
    if kind in (Union, UnionType):
        return " | ".join(map(_type, args))
    if kind is Annotated:
        return _type(args[0])
    if kind is dict:
        return f"Record<string, {_type(args[1])}>"
    if kind is list or args[1:] == (...,):
        return f"({_type(args[0])})[]" if get_origin(args[0]) in (Literal, Union, UnionType) else f"{_type(args[0])}[]"
    if kind is tuple:
        return f"[{', '.join(map(_type, args))}]"
    return PLAIN[of]


if __name__ == "__main__":
    FILE.write_text(typescript(), "utf-8")
    print(f"{FILE} written")
