"""Seeded damage to files that knows how they are built: numbers and lines of text, bytes, arrays in archives, nested tables."""

import io
import json
import random
import re
import struct
import zipfile
from typing import Any

_DIGITS, _HEX, _LONG, _DEEP = "9" * 5000, "0x" + "f" * 5000, '"' + "long " * 2000 + '"', "[" * 3000 + "]" * 3000
NUMBERS = (
    *("0", "-1", "1.5", "1e300", "-1e300", "1e-300", "1e9", "nan", "-inf", "2147483648", "9223372036854775808", _DIGITS, _HEX),
    *("true", '""', '"x"', "[]", "{}", "[[[]]]", "1979-05-27", '"\\u0000.x"', _LONG, _DEEP),
)
STRANGE = ("\0", '"', "[", "=", "\ufeff", "ü", "a." * 3000, "$", " ", "<!", "\x1b[31m")
VALUES = (None, 0, -1, 1e300, -1e300, 1e-300, 2**70, "", "x" * 5000, "../x", "/dev/zero", "\0.x", [], {}, [[]], True, 1e6)
SHAPES = ("(100000, 100000)", "(-1,)", "()", "(0,)", f"({'9' * 4000},)", "(1, " * 400, "(1.5,)", "(1000000000,)")
TYPES = ("|O", "<f8", "<c16", "<U9", "|S0", "<M8[s]", "|b1", "<i8", "<f2", "x")
WORDS = (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
NUMBER = re.compile(r"(?<![\w.])[-+]?\d[\d_.]*(?:[eE][-+]?\d+)?|\"[^\"\n]*\"|\btrue\b|\bfalse\b")
LONGEST = 60_000  # characters that repeating lines may bring a text to


def of_text(text: str, rng: random.Random) -> str:
    """A text with one to four places damaged: a value, a line, characters."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        text = rng.choice((_value, _value, _value, _line, _characters))(text, rng)
    return text


def _value(text: str, rng: random.Random) -> str:
    found = list(NUMBER.finditer(text))
    if not found:
        return text
    place = rng.choice(found)
    return text[: place.start()] + rng.choice(NUMBERS) + text[place.end() :]


def _line(text: str, rng: random.Random) -> str:
    lines = text.split("\n")
    k, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    match rng.randrange(5):
        case 0:
            del lines[k]
        case 1:
            lines.insert(j, lines[k])
        case 2:
            lines[k], lines[j] = lines[j], lines[k]
        case 3:
            lines[k:k] = lines[k : k + 5] * rng.choice((2, 50)) if len(text) < LONGEST else []
        case _:
            del lines[k:]
    return "\n".join(lines)


def _characters(text: str, rng: random.Random) -> str:
    k = rng.randrange(len(text) + 1)
    return text[:k] + rng.choice(STRANGE) + text[k + rng.randrange(3) :]


def of_bytes(data: bytes, rng: random.Random) -> bytes:
    """Bytes with one to four places damaged, more often near the start, where headers are."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        n = len(changed)
        k = min(int(n * rng.random() ** rng.choice((1, 4))), max(n - 1, 0))
        match rng.randrange(6):
            case 0 if n:
                changed[k] ^= 1 << rng.randrange(8)
            case 1:
                changed[k : k + 4] = struct.pack(rng.choice("<>") + "I", rng.choice(WORDS))
            case 2:
                changed[k : k + 8] = struct.pack(rng.choice("<>") + "d", rng.choice((float("nan"), 1e300, -1e300, 1e-300, float("inf"))))
            case 3:
                del changed[k : k + rng.choice((1, 7, 1000))]
            case 4:
                changed[k:k] = changed[k : k + rng.choice((1, 16, 256))]
            case _:
                del changed[k:]
    return bytes(changed)


def of_archive(data: bytes, rng: random.Random) -> bytes:
    """A .npz or .pt with one entry damaged, left out, doubled or renamed; now and then its bytes."""
    if rng.random() < 0.2:
        return of_bytes(data, rng)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = [(name, archive.read(name)) for name in archive.namelist()]
    k = rng.randrange(len(entries))
    name, content = entries[k]
    match rng.randrange(6):
        case 0:
            del entries[k]
        case 1:
            entries[k] = (entries[rng.randrange(len(entries))][0] + rng.choice(("", "x")), content)
        case 2:
            entries[k] = (name, of_array(content, rng))
        case 3:
            entries[k] = (name, of_text(content.decode("latin-1"), rng).encode("latin-1", "replace"))
        case 4:
            entries[k] = (name, rng.choice((b"", b"no array", bytes(100_000_000), entries[rng.randrange(len(entries))][1])))
        case _:
            entries[k] = (name, of_bytes(content, rng))
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, content in dict(entries).items():
            archive.writestr(name, content)
    return buffer.getvalue()


def of_array(data: bytes, rng: random.Random) -> bytes:
    """A .npy whose header declares something else."""
    start = data.find(b"{")
    end = data.find(b"\n", start)
    if start < 0 or end < 0:
        return of_bytes(data, rng)
    header = data[start:end].decode("latin-1")
    shape, kind, order = rng.choice(SHAPES), rng.choice(TYPES), rng.choice(("True", "'", "None", "[" * 90))
    old, new = rng.choice(((r"\(.*\)", shape), (r"'descr': '[^']*'", f"'descr': '{kind}'"), ("False", order)))
    changed = re.sub(old, lambda _: new, header).rstrip()
    return data[: start - 2] + struct.pack("<H", len(changed) + 1) + changed.encode("latin-1") + b"\n" + data[end + 1 :]


def of_tables(value: Any, rng: random.Random) -> Any:
    """Plain data with one to three places replaced, left out or added."""
    value = json.loads(json.dumps(value))
    for _ in range(rng.choice((1, 1, 2, 3))):
        places = list(_places(value))
        if not places:
            return value
        holder, key = rng.choice(places)
        match rng.randrange(6):
            case 0:
                del holder[key]
            case 1:
                other, at = rng.choice(places)
                holder[key] = json.loads(json.dumps(other[at])) if at in other or (isinstance(other, list) and at < len(other)) else None
            case 2 if isinstance(holder, dict):
                holder[f"{key}x"] = holder[key]
            case _:
                holder[key] = rng.choice(VALUES)
    return value


def _places(value: Any) -> list[tuple[Any, Any]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [place for key, inner in items for place in ((value, key), *_places(inner))]
