"""What one client gets: the newest of everything that it shows, each part only where it has changed since it got that last."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch

from loop.studio.messages import VIEWS, Coded, View, coded, grey, packed
from loop.studio.runs import Run
from loop.studio.session import Published
from loop.studio.shapes import whole

AHEAD: Final = 2  # steps of a run that a client may not have shown yet: one on its way, and one that it is at
HALF: Final = 1024.0  # peak of a module in units of its half floats, far from where these overflow


class Feed:
    """What a client has got of a session. It is used by one thread at a time, which may be another one each time."""

    def __init__(self) -> None:
        self._number, self._steps = -1, 0
        self._sent, self._wanted = list[Sent](), frozenset[View]()

    def messages(self, published: Published, looks: "Looks") -> Iterator[bytes]:
        """Those that bring the client up to date, as it looks."""
        if published.number != self._number and published.scenario is not None:
            self._number = published.number
            self._sent = [Sent(number, run) for number, run in enumerate(published.runs)]
            yield packed(published.scenario)
        more, self._wanted = looks.wanted - self._wanted, looks.wanted
        for sent in self._sent:
            yield from sent.edits()
            yield from sent.rows()
            run, step = looks.at or (sent.number, len(sent.run.snapshots) - 1)
            if run == sent.number and self._steps - looks.shown < AHEAD * len(self._sent):
                fresh = list(sent.step(min(step, len(sent.run.snapshots) - 1), looks, anew=bool(more)))
                self._steps += bool(fresh)
                yield from fresh


@dataclass(frozen=True)
class Looks:
    """How a client looks. at: run and step in place of the newest. shown: steps that it has shown."""

    wanted: frozenset[View] = frozenset(VIEWS)
    at: tuple[int, int] | None = None
    shown: int = 0


class Sent:
    """What a client has got of one run."""

    def __init__(self, number: int, run: Run) -> None:
        self.number, self.run = number, run
        self._rows, self._edits, self._meshes, self._step = 0, 0, 0, (-1, False)
        self._u: list[torch.Tensor | None] = [None] * len(run.simulation.modules)  # as last shown
        self._textures: list[np.ndarray | None] = [None] * len(run.simulation.modules)
        self._utilisations: list[torch.Tensor | None] = [None] * len(run.simulation.modules)

    def edits(self) -> Iterator[bytes]:
        """Those that it was not told of."""
        for step, overrides in self.run.edits[self._edits :]:
            self._edits += 1
            yield packed({"type": "edit", "run": self.number, "step": step, "overrides": overrides})

    def rows(self) -> Iterator[bytes]:
        """Values of the steps that it lacks."""
        fresh = self.run.rows[self._rows :]
        if fresh:
            head = {"type": "rows", "run": self.number, "first": self._rows}
            self._rows += len(fresh)
            yield packed(head, {"rows": coded(np.stack(fresh))})

    def step(self, number: int, looks: Looks, anew: bool) -> Iterator[bytes]:
        """A step, and before it the meshes that it lacks; nothing where it has got that step, unless it shall come anew."""
        scrubbed, wanted = looks.at is not None, looks.wanted
        if (number, scrubbed) == self._step and not anew:
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
