"""What one client gets: the newest of everything that it shows, each part only where it has changed since it got that last."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import torch

from loop.studio.messages import VIEWS, Coded, View, coded, grey, packed
from loop.studio.runs import Run
from loop.studio.session import Published
from loop.studio.shapes import whole

HALF: Final = 1024.0  # peak of a module in units of its half floats, far from where these overflow


class Feed:
    """What a client has got of a session. It is used by one thread at a time, which may be another one each time."""

    def __init__(self) -> None:
        self.wanted: frozenset[View] = frozenset(VIEWS)
        self.scrubbed: tuple[int, int] | None = None  # run and step that are looked at in place of the newest
        self._number = -1
        self._sent = list[Sent]()

    def messages(self, published: Published) -> Iterator[bytes]:
        """Those that bring the client up to date."""
        if published.number != self._number and published.scenario is not None:
            self._number, self.scrubbed = published.number, None
            self._sent = [Sent(number, run) for number, run in enumerate(published.runs)]
            yield packed(published.scenario)
        for sent in self._sent:
            yield from sent.rows()
            scrubbed = self.scrubbed is not None and self.scrubbed[0] == sent.number
            if scrubbed or self.scrubbed is None:
                step = self.scrubbed[1] if self.scrubbed is not None else len(sent.run.snapshots) - 1
                yield from sent.step(min(step, len(sent.run.snapshots) - 1), scrubbed, self.wanted)


class Sent:
    """What a client has got of one run."""

    def __init__(self, number: int, run: Run) -> None:
        self.number, self.run = number, run
        self._rows, self._meshes, self._step = 0, 0, (-1, False)
        self._u: list[torch.Tensor | None] = [None] * len(run.simulation.modules)  # as last shown
        self._textures: list[np.ndarray | None] = [None] * len(run.simulation.modules)
        self._utilisations: list[torch.Tensor | None] = [None] * len(run.simulation.modules)

    def rows(self) -> Iterator[bytes]:
        """Values of the steps that it lacks."""
        fresh = self.run.rows[self._rows :]
        if fresh:
            head = {"type": "rows", "run": self.number, "first": self._rows}
            self._rows += len(fresh)
            yield packed(head, {"rows": coded(np.stack(fresh))})

    def step(self, number: int, scrubbed: bool, wanted: frozenset[View]) -> Iterator[bytes]:
        """A step, and before it the meshes that it lacks; nothing where it has got that step."""
        if (number, scrubbed) == self._step:
            return
        self._step = number, scrubbed
        snapshot = self.run.snapshots[number]
        if fresh := self.run.shapes.meshes[self._meshes :]:
            self._meshes += len(fresh)
            heads, arrays = whole(fresh)
            yield packed({"type": "meshes", "run": self.number, "meshes": heads}, {name: coded(each) for name, each in arrays.items()})
        arrays_, light_rows, scales = dict[str, Coded](), dict[str, Any](), []
        for k, peak_cd in enumerate(self.run.peaks_cd):
            scales.append(max(peak_cd, 1e-6) / HALF)
            if not snapshot.lights:
                continue
            u = snapshot.lights[k]
            if "light" in wanted and u is not self._u[k]:
                self._u[k] = u
                if (changed := self._changed(k, u, scales[k])) is not None:
                    light_rows[str(k)], arrays_[f"light.{k}"] = changed
            if "matrix" in wanted and u is not self._utilisations[k]:
                self._utilisations[k] = u
                light = self.run.simulation.modules[k].headlight
                share = (255 * u.clamp(0, 1)).round().byte().view(light.pixel_rows, light.pixel_cols)
                arrays_[f"u.{k}"] = coded(share.numpy())
        if "camera" in wanted:
            arrays_ |= {name: grey(picture) for name, picture in self._seen(number).items()}
        head = {"type": "step", "run": self.number, "scrub": scrubbed, **snapshot.head, "light_rows": light_rows}
        head["modules"] = [{**each, "scale_cd": scale} for each, scale in zip(snapshot.head["modules"], scales, strict=True)]
        yield packed(head, arrays_)

    def _seen(self, number: int) -> dict[str, np.ndarray]:
        """Pictures of a step, or of the last one before it that has some."""
        return next((each.pictures for each in reversed(self.run.snapshots[: number + 1]) if each.pictures), {})

    def _changed(self, k: int, u: torch.Tensor, scale_cd: float) -> tuple[list[int], Coded] | None:
        """Rows of a module's light texture in units of scale_cd that it lacks, and which they are."""
        headlight = self.run.simulation.modules[k].headlight
        texture = (headlight.light_texture(u.to(headlight.matrix.values)).cpu().numpy() / scale_cd).astype(np.float16)
        before, self._textures[k] = self._textures[k], texture
        differs = np.ones(len(texture), bool) if before is None else (before != texture).any(1)
        if not differs.any():
            return None
        first, last = (int(each) for each in np.flatnonzero(differs)[[0, -1]])
        return [first, last + 1], coded(texture[first : last + 1])
