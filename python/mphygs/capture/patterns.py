"""Patterns of JSON values: what a document that anybody may have changed must be before it is used.

A pattern looks at an entry and raises CaptureError, one line, at the first value that is something else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from mphygs.capture.document import Entry

Pattern = Callable[[Entry], object]

# Numbers further from zero come from no fit: their squares, or their thousandfold, would be none.
LARGEST = 1e100
_LONGEST_TEXT = 100_000  # characters


def number(entry: Entry) -> float:
    """A finite number, with room for its square."""
    return entry.within(-LARGEST, LARGEST, "a number")


def size(entry: Entry) -> float:
    """A number that is not negative."""
    return entry.within(0.0, LARGEST, "a number")


def count(entry: Entry) -> int:
    """A whole number, zero or more."""
    if entry.integer() < 0 or entry.integer() > LARGEST:
        raise entry.wrong("a whole number, zero or more")
    return entry.integer()


def sentence(entry: Entry) -> str:
    """A text that can be shown, of any length; it may be empty."""
    if not isinstance(entry.value, str):
        raise entry.wrong("a text")
    if not entry.value.isprintable() or len(entry.value) > _LONGEST_TEXT:
        raise entry.fault("is no line that prints", "a text")
    return entry.value


def one_of(known: Iterable[str]) -> Pattern:
    """One of a few words."""
    words = tuple(known)
    return lambda entry: entry.choice(words)


def maybe(pattern: Pattern) -> Pattern:
    """null, or what the pattern says."""
    return lambda entry: None if entry.value is None else pattern(entry)


def many(pattern: Pattern, *, least: int = 0, most: int | None = None) -> Pattern:
    """A list, each element of which is as the pattern says."""

    def look(entry: Entry) -> None:
        items = entry.elements()
        if not least <= len(items) <= (len(items) if most is None else most):
            raise entry.fault(f"has {len(items)} entries", str(least) + ("" if least == most else " or more"))
        for item in items:
            pattern(item)

    return look


def by_name(pattern: Pattern) -> Pattern:
    """An object of any names that can be shown, each value of which is as the pattern says."""

    def look(entry: Entry) -> None:
        for key, item in entry.children():
            Entry(key, entry.file, entry.key).name()
            pattern(item)

    return look


def record(required: Mapping[str, Pattern], optional: Mapping[str, Pattern] | None = None) -> Pattern:
    """An object with some keys, and perhaps others; what it has besides is of no meaning here."""

    def look(entry: Entry) -> None:
        for key, pattern in required.items():
            pattern(entry[key])
        for key, pattern in (optional or {}).items():
            if (given := entry.get(key)) is not None:
                pattern(given)

    return look


FRAMES = many(count, least=2, most=2)
