"""Typed reading of a JSON document: every value knows its key path, unknown keys are refused."""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from mphygs.capture.errors import CaptureError, fault

# A document holds names and numbers; arrays stand in files of their own.
_LARGEST = 100_000_000  # bytes
_LONGEST_NAME = 200  # characters


def read_document(path: Path, *, finite: bool = True) -> Entry:
    """The JSON document at `path`: UTF-8, no comments, no repeated keys, and, where finite, no NaN or
    Infinity."""
    try:
        size = path.stat().st_size
        if size > _LARGEST:
            raise fault(str(path), f"has {size} bytes", f"a document of at most {_LARGEST}")
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise fault(str(path), f"byte {error.start} is not UTF-8", "a JSON text file") from error
    except OSError as error:
        raise fault(str(path), f"cannot be read ({error.strerror})", "a JSON text file") from error

    def pairs(items: list[tuple[str, object]]) -> dict[str, object]:
        table = dict(items)
        if len(table) < len(items):
            names = [key for key, _ in items]
            twice = next(key for key in names if names.count(key) > 1)
            raise fault(str(path), f'key "{twice}" is given twice in one object', "every key once")
        return table

    def constant(name: str) -> NoReturn:
        raise fault(str(path), f"{name} is not JSON", "finite numbers")

    try:
        value = json.loads(text, object_pairs_hook=pairs, parse_constant=constant if finite else None)
    except json.JSONDecodeError as error:
        raise fault(f"{path}: line {error.lineno} column {error.colno}", error.msg, "valid JSON") from error
    except CaptureError:
        raise
    except RecursionError as error:
        raise fault(str(path), "is nested too deep", "valid JSON") from error
    except ValueError as error:
        raise fault(str(path), str(error), "valid JSON") from error
    return Entry(value=value, file=str(path), key="")


def kind(value: object) -> str:
    """How a JSON value is named in a message."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if value is None:
        return "null"
    if isinstance(value, int | float):
        return str(value) if len(str(value)) < 40 else "a number of too many digits"
    if isinstance(value, str):
        return f'"{value}"' if len(value) < 60 else f"a text of {len(value)} characters"
    return "a list" if isinstance(value, list) else "an object {...}"


def _shape(value: object) -> tuple[int, ...]:
    """The shape of nested lists, taken from the first element at each level."""
    shape: tuple[int, ...] = ()
    while isinstance(value, list):
        shape += (len(value),)
        value = value[0] if value else None
    return shape


def written(shape: Iterable[int | None], free: str = "N") -> str:
    """A shape as it is named in a message, e.g. `(N, 3)`; free: letters for the sizes that are not given."""
    letters = iter(free)
    sizes = [next(letters, free[-1]) if size is None else str(size) for size in shape]
    return f"({', '.join(sizes)}{',' if len(sizes) == 1 else ''})"


@dataclass(frozen=True)
class Entry:
    """A value of a JSON document with the file and the key path it came from."""

    value: object
    file: str
    key: str

    @property
    def where(self) -> str:
        """File and key path, the beginning of every message."""
        return f"{self.file}: {self.key}" if self.key else self.file

    def fault(self, what: str, expected: str) -> CaptureError:
        """An error at this entry."""
        return fault(self.where, what, expected)

    def wrong(self, expected: str) -> CaptureError:
        """An error at this entry that shows its value."""
        return self.fault(f"is {kind(self.value)}", expected)

    def table(self) -> dict[str, object]:
        """The value as a JSON object."""
        if not isinstance(self.value, dict):
            raise self.wrong("an object {...}")
        return self.value

    def check_keys(self, *, required: Iterable[str] = (), optional: Iterable[str] = ()) -> Entry:
        """Refuse keys that are not listed and objects that lack a required one; return this entry."""
        required = tuple(required)
        known = (*required, *optional)
        table = self.table()
        for key in table:
            if key not in known:
                close = difflib.get_close_matches(key, known, n=1)
                hint = f' (did you mean "{close[0]}"?)' if close else ""
                raise self.child(key).fault(f"unknown key{hint}", f"one of {', '.join(known)}")
        for key in required:
            if key not in table:
                raise self.fault(f'"{key}" is missing', f"the keys {', '.join(required)}")
        return self

    def child(self, key: str) -> Entry:
        """The entry named `key`, present or not (its value is then None)."""
        return Entry(self.table().get(key), self.file, f"{self.key}.{key}" if self.key else key)

    def __getitem__(self, key: str) -> Entry:
        if key not in self.table():
            raise self.fault(f'"{key}" is missing', "it to be given")
        return self.child(key)

    def get(self, key: str) -> Entry | None:
        """The entry named `key`, or None where the document has none."""
        return self.child(key) if key in self.table() else None

    def children(self) -> Iterator[tuple[str, Entry]]:
        """The entries of an object with their names."""
        for key in self.table():
            yield key, self.child(key)

    def elements(self) -> list[Entry]:
        """The entries of a list."""
        if not isinstance(self.value, list):
            raise self.wrong("a list [...]")
        return [Entry(item, self.file, f"{self.key}[{index}]") for index, item in enumerate(self.value)]

    def text(self) -> str:
        """The value as a text that is not empty."""
        if not isinstance(self.value, str) or not self.value.strip():
            raise self.wrong("a text")
        return self.value

    def name(self) -> str:
        """The value as a text that can be shown: of one line, not longer than a name is."""
        text = self.text()
        if not text.isprintable():
            raise self.fault("holds characters that do not print", "a name")
        if len(text) > _LONGEST_NAME:
            raise self.fault(f"is a text of {len(text)} characters", f"a name of at most {_LONGEST_NAME}")
        return text

    def choice(self, known: Iterable[str]) -> str:
        """The value as one of a few words."""
        if self.value not in tuple(known):
            raise self.wrong(f"one of {', '.join(known)}")
        return self.text()

    def flag(self) -> bool:
        """The value as true or false."""
        if not isinstance(self.value, bool):
            raise self.wrong("true or false")
        return self.value

    def within(self, lower: float, upper: float, meaning: str) -> float:
        """The value as a number from `lower` to `upper`; meaning: what it is, with its unit."""
        number = self.number()
        if not lower <= number <= upper:
            raise self.wrong(f"{meaning} from {lower:g} to {upper:g}")
        return number

    def number(self) -> float:
        """The value as a finite number."""
        if isinstance(self.value, bool) or not isinstance(self.value, int | float):
            raise self.wrong("a number")
        try:
            number = float(self.value)
        except OverflowError as error:
            raise self.wrong("a finite number") from error
        if not math.isfinite(number):
            raise self.wrong("a finite number")
        return number

    def integer(self) -> int:
        """The value as an integer (`80.0` is not one)."""
        if isinstance(self.value, bool) or not isinstance(self.value, int):
            raise self.wrong("an integer")
        return self.value

    def array(self, shape: tuple[int | None, ...], *, most: float = math.inf) -> np.ndarray:
        """The value as a float64 array of `shape`, in which None stands for any size above zero.

        most: no number in it may be further from zero.
        """
        expected = f"an array of shape {written(shape)}"

        def numbers(entry: Entry, sizes: tuple[int | None, ...]) -> object:
            if not sizes:
                number = entry.number()
                if abs(number) > most:
                    raise entry.wrong(f"a number of at most {most:g}")
                return number
            if not isinstance(entry.value, list):
                raise entry.wrong(f"{expected} at {self.key}")
            if len(entry.value) != (len(entry.value) or 1 if sizes[0] is None else sizes[0]):
                at = f" at {self.key}" if entry.key != self.key else ""
                raise entry.fault(f"has shape {written(_shape(entry.value))}", f"{expected}{at}")
            return [numbers(item, sizes[1:]) for item in entry.elements()]

        return np.array(numbers(self, shape), dtype=np.float64)
