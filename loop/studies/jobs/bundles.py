"""Jobs that are done together, where that is faster than one by one."""

from collections.abc import Sequence

MOST = 16  # jobs at once: more are no faster, and a job that ends is kept on disk sooner


def bundles(kinds: Sequence[str | None], workers: int) -> list[list[int]]:
    """Places of jobs that are done together: those of one kind, in so many parts that no worker is idle. Jobs of kind None are alone."""
    alike: dict[str, list[int]] = {}
    found = []
    for place, kind in enumerate(kinds):
        if kind is None:
            found.append([place])
        else:
            alike.setdefault(kind, []).append(place)
    for places in alike.values():
        size = min(-(-len(places) // workers), MOST)
        found += [places[k : k + size] for k in range(0, len(places), size)]
    return sorted(found)


def told(found: Sequence[Sequence[int]], title: str) -> str | None:
    """How many jobs are done together, in words; None where none are."""
    together = [len(each) for each in found if len(each) > 1]
    return f"{sum(together)} of {sum(map(len, found))} {title} in batches of up to {max(together)}" if together else None
