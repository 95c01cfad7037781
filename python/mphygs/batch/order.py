"""What a batch is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass


@dataclass(frozen=True, kw_only=True)
class Order:
    """A batch. folders: as given; command: run on each of them; options: of the command, passed on to each;
    seeds, each_effect: one run for each of them; place: folder that relative paths are meant from."""

    command: str
    folders: tuple[str, ...]
    options: tuple[str, ...] = ()
    seeds: tuple[int, ...] = ()
    each_effect: tuple[str, ...] = ()
    plugin: str | None = None
    place: str = "."

    def document(self) -> dict[str, object]:
        """The order as JSON knows it."""
        return asdict(self)

    @classmethod
    def of(cls, found: Mapping[str, object], where: str) -> Order:
        """The order of a document. Raises ValueError for a damaged one."""
        known = {"command": str, "plugin": (str, type(None)), "place": str}
        lists = {"folders": str, "options": str, "each_effect": str, "seeds": int}
        for key, kind in known.items():
            if not isinstance(found.get(key), kind):
                raise ValueError(f"{where}: has no '{key}' that a batch writes; expected one of its own")
        for key, kind in lists.items():
            if not isinstance(found.get(key), list) or not all(isinstance(v, kind) for v in found[key]):
                raise ValueError(f"{where}: has no '{key}' that a batch writes; expected one of its own")
        return cls(**{k: found[k] for k in known}, **{k: tuple(found[k]) for k in lists})
