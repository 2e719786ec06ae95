"""Caches: the last few results of a method; the parts of an image that were read."""

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, Final, ParamSpec, TypeVar, cast
from weakref import WeakMethod

from torch import Tensor
from torch.utils._pytree import tree_map_only

Part = tuple[slice, slice]  # rows and columns of an image, with start and stop
AROUND: Final = (0.03, 0.08)  # shares of rows and columns that are computed around the part that is read, for the next reader
ABOUT: Final = {Tensor.dim, Tensor.size, *(getattr(Tensor, name).__get__ for name in ("shape", "dtype", "device", "ndim", "requires_grad"))}


class PartialImage(Tensor):
    """An image `[height, width]` that is computed on access: `image[..., rows, columns]` computes that part, any other use the whole."""

    part_of: Callable[[Part], Tensor]
    known: Part | None
    pixels: Tensor

    @staticmethod
    def of(height: int, width: int, like: Tensor, part_of: Callable[[Part], Tensor]) -> "PartialImage":
        """part_of: computes a part, equal to the bit to that part of the whole. like: gives dtype and device."""
        image: PartialImage = Tensor._make_subclass(PartialImage, like.new_zeros(()).expand(height, width))
        image.part_of, image.known = part_of, None
        return image

    @classmethod
    def __torch_function__(cls, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Mapping[str, Any] | None = None) -> Any:
        if func in ABOUT:
            return super().__torch_function__(func, types, args, kwargs)
        if func is Tensor.__getitem__ and isinstance(args[1], tuple):
            wanted = tuple(each for each in args[1] if each is not Ellipsis)
            if len(wanted) == 2 and all(isinstance(each, slice) and each.step is None for each in wanted):
                return args[0]._within(*wanted)
        args, given = tree_map_only(PartialImage, lambda image: image._within(slice(None), slice(None)), (args, dict(kwargs or {})))
        return func(*args, **given)

    def _within(self, rows: slice, columns: slice) -> Tensor:
        ends = (each.indices(n) for each, n in zip((rows, columns), self.shape, strict=True))
        asked, known = tuple(slice(start, max(start, stop)) for start, stop, _ in ends), self.known
        if known is None or any(each.start < have.start or each.stop > have.stop for each, have in zip(asked, known, strict=True)):
            spans = zip(asked, known or asked, AROUND, self.shape, strict=True)
            v, u = (_span(min(each.start, have.start), max(each.stop, have.stop), share, n) for each, have, share, n in spans)
            self.pixels, self.known = self.part_of((v, u)), (known := (v, u))
        (v, u), (top, left) = asked, (each.start for each in known)
        return self.pixels[..., v.start - top : v.stop - top, u.start - left : u.stop - left]


def _span(start: int, stop: int, share: float, n: int) -> slice:
    """From start to stop and a share of n to both sides, within n."""
    around = math.ceil(share * n)
    return slice(max(start - around, 0), min(stop + around, n))


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def keeping(most: int, method: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """A bound method with a cache of its last `most` results; store it on the object. Arguments must be hashable.

    Unlike `lru_cache` it holds no reference to the object, whose memory (often hundreds of megabytes) is released with its last reference.
    """
    of_object = WeakMethod(method)

    @lru_cache(most)
    def call(*arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        living = of_object()
        assert living is not None, "the object that keeps this calls it"
        return living(*arguments, **named)

    return cast(Callable[Arguments, Result], call)
