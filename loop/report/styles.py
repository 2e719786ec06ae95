"""Views of a lamp, their styles and picture formats; imports nothing heavy."""

import os
from collections.abc import Mapping
from pathlib import Path

from luxloop.world.errors import LuxloopError, did_you_mean

# styles of each view, the default first
VIEWS: Mapping[str, tuple[str, ...]] = {
    "overview": ("isolux",),
    "wall": ("isolux", "isocandela", "falsecolour", "luminance"),
    "driver": ("luminance", "falsecolour", "isolux"),
    "birdseye": ("isolux", "falsecolour", "luminance"),
    "volume": ("luminance", "falsecolour"),
    "pixels": ("falsecolour",),
    "texture": ("falsecolour",),
}
FORMATS = (".png", ".jpg", ".jpeg", ".pdf", ".svg")


def style_of(view: str, style: str | None) -> str:
    """The style of a view, by default the first. Raises LuxloopError for unknown names, with the nearest known one."""
    if view not in VIEWS:
        raise LuxloopError(f"there is no view {view!r}; {did_you_mean(view, VIEWS)}")
    if style is None or style in VIEWS[view]:
        return style or VIEWS[view][0]
    known = dict.fromkeys(name for names in VIEWS.values() for name in names)
    if style not in known:
        raise LuxloopError(f"there is no style {style!r}; {did_you_mean(style, known)}")
    raise LuxloopError(f"view {view!r} has no style {style!r}; it has {', '.join(VIEWS[view])}")


def check_out(out: Path) -> None:
    """Raises LuxloopError for a file name without a picture format's suffix, and for a missing folder."""
    if out.suffix.lower() not in FORMATS:
        raise LuxloopError(f"{out}: pictures are written as {', '.join(FORMATS)}; end the file's name in one of them")
    if not os.path.isdir(out.parent):
        raise LuxloopError(f"{out}: cannot be written, for there is no folder {out.parent}; make it first")
