"""Tasks and orders of a batch, for the tests of batches."""

from __future__ import annotations

from pathlib import Path

from mphygs.batch.order import Order
from mphygs.batch.work import Task


def task(name: str, folder: Path = Path("/nowhere"), **more: object) -> Task:
    known = {"words": ("fit", "x"), "run": folder / name, "logs": folder / "logs", "place": folder}
    return Task(name, "x", **(known | {"limited": True, "resumable": True} | more))


def order(*folders: str, **more: object) -> Order:
    return Order(**({"command": "fit", "folders": folders} | more))
