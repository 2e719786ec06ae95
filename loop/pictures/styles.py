"""The views of a lamp, their styles and the formats of pictures: what can be refused before anything heavy is imported."""

from collections.abc import Mapping
from pathlib import Path

from world.errors import LuxloopError, did_you_mean

# Styles of each view; the first one unless another is asked for.
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
    """The style of a view, its own where none is given. Raises LuxloopError for what there is not, with the nearest name."""
    if view not in VIEWS:
        raise LuxloopError(f"there is no view {view!r}; {did_you_mean(view, VIEWS)}")
    if style is None or style in VIEWS[view]:
        return style or VIEWS[view][0]
    known = dict.fromkeys(name for names in VIEWS.values() for name in names)
    if style not in known:
        raise LuxloopError(f"there is no style {style!r}; {did_you_mean(style, known)}")
    raise LuxloopError(f"the view {view!r} is not to be had as {style!r}; give one of {', '.join(VIEWS[view])}")


def check_format(out: Path) -> None:
    """Raises LuxloopError where a file's name does not end in the format of a picture."""
    if out.suffix.lower() not in FORMATS:
        raise LuxloopError(f"{out}: pictures are written as {', '.join(FORMATS)}; end the file's name in one of them")
