"""Changed documents, as hypothesis draws them: what somebody may write, or what a damaged file holds."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

SETTINGS = settings(
    max_examples=150,
    deadline=2000,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

# That no page may run.
SCRIPT = "</script><script>alert(1)</script>"

# What somebody may write for a value, or what a damaged file holds.
NUMBERS = st.one_of(
    st.sampled_from([0, -1, 1, 2, 1e-320, 1e-12, 1e-6, 1e6, 1e12, 1e300, -1e308, 10**30, 2**63, 0.5, 1e400]),
    st.floats(allow_nan=True, allow_infinity=True),
    st.integers(),
)
TEXTS = st.one_of(
    st.sampled_from(
        [
            "",
            " ",
            "x",
            "fixed",
            "../up",
            "/etc/passwd",
            "a/b",
            "a\x1b[31m",
            "a\nb",
            "x" * 5000,
            "\u202ebar",
            "..",
            "nan",
            SCRIPT,
        ]
    ),
    st.text(max_size=20),
)
VALUES = st.one_of(
    NUMBERS,
    TEXTS,
    st.none(),
    st.booleans(),
    st.lists(NUMBERS, max_size=4),
    st.lists(TEXTS, max_size=3),
    st.dictionaries(TEXTS, NUMBERS, max_size=2),
    st.builds(lambda: [[[[]]]]),
)
Keys = tuple[str | int, ...]


def places(document: Any, here: Keys = ()) -> Iterator[Keys]:
    """The keys of every value in a document, containers before what is in them."""
    if here:
        yield here
    items = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in items:
        if isinstance(value, (dict, list)):
            yield from places(value, (*here, key))
        else:
            yield (*here, key)


@st.composite
def mutations(draw: st.DrawFn, document: dict) -> dict:
    """The document with one or two places changed, taken away, written twice, or put elsewhere."""
    changed = copy.deepcopy(document)
    for _ in range(draw(st.integers(1, 2))):
        keys = draw(st.sampled_from(list(places(changed)) or [()]))
        if not keys:
            break
        inner = changed
        for key in keys[:-1]:
            inner = inner[key]
        last = keys[-1]
        kind = draw(st.sampled_from(["put", "put", "put", "drop", "scale", "copy", "add"]))
        if kind == "put":
            inner[last] = draw(VALUES)
        elif kind == "drop":
            del inner[last]
        elif kind == "scale" and isinstance(inner[last], (int, float)):
            inner[last] = inner[last] * draw(st.sampled_from([-1.0, 1e-3, 1e3, 1e9, 1e-9]))
        elif kind == "copy" and isinstance(inner, list):
            inner.append(copy.deepcopy(inner[last]))
        elif kind == "add" and isinstance(inner, dict):
            inner[draw(TEXTS)] = draw(VALUES)
    return changed


def one_line(error: ValueError, where: Path) -> None:
    line = str(error)
    assert line.isprintable() and len(line) < 3000 and "expected" in line and str(where) in line, line
