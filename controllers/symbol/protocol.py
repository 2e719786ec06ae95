"""What every symbol controller is: state in, state out, and a pose of the symbol's primitive to be shown."""

from typing import Any, Protocol

from torch import Tensor

from controllers.symbol.observer import Seen


class SymbolController(Protocol):
    """Moves the symbol's primitive; its state is a frozen dataclass of tensors."""

    def start(self, pose: Tensor) -> Any:
        """State that shows the pose `[..., 4]` (x, y in m, roll, pitch in rad) first."""
        ...

    def pose(self, state: Any) -> Tensor:
        """Pose `[..., 4]` that is to be shown now."""
        ...

    def step(self, state: Any, seen: Seen) -> Any:
        """The state after one look at the symbol."""
        ...
