"""The JSON reader: types, shapes, unknown keys, key paths in messages."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mphygs.capture.document import Entry, read_document
from mphygs.capture.errors import CaptureError


def entry(value: object) -> Entry:
    return Entry({"outer": [{"inner": value}]}, "f.json", "")["outer"].elements()[0]["inner"]


def read(tmp_path: Path, text: str | bytes) -> Entry:
    path = tmp_path / "f.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_document(path)


def test_values_come_back_with_their_type() -> None:
    assert entry(3).number() == 3.0 and isinstance(entry(3).number(), float)
    assert entry(3).integer() == 3
    assert entry("a b").text() == "a b"
    array = entry([[1, 2.5], [3, 4], [5, 6]]).array((None, 2))
    assert array.dtype == np.float64 and array.tolist() == [[1, 2.5], [3, 4], [5, 6]]
    assert entry({"x": 1}).get("y") is None


@pytest.mark.parametrize(
    ("value", "call", "what"),
    [
        (True, Entry.number, "is true; expected a number"),
        ("1.0", Entry.number, 'is "1.0"; expected a number'),
        (None, Entry.number, "is null; expected a number"),
        ([1], Entry.number, "is a list; expected a number"),
        (float("inf"), Entry.number, "is inf; expected a finite number"),
        (10**400, Entry.number, "expected a finite number"),
        (80.0, Entry.integer, "is 80.0; expected an integer"),
        (False, Entry.integer, "is false; expected an integer"),
        (3, Entry.text, "is 3; expected a text"),
        (" ", Entry.text, "expected a text"),
        ("abc", Entry.elements, 'is "abc"; expected a list'),
        ([], Entry.table, "is a list; expected an object"),
    ],
)
def test_wrong_types_are_named_with_their_path(value: object, call: Callable, what: str) -> None:
    with pytest.raises(CaptureError) as caught:
        call(entry(value))
    assert str(caught.value).startswith("f.json: outer[0].inner: ")
    assert what in str(caught.value)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([[1, 2, 3], [4, 5]], "outer[0].inner[1]: has shape (2,); expected an array of shape (N, 3)"),
        ([1, 2, 3], "outer[0].inner[0]: is 1; expected an array of shape (N, 3)"),
        ([[1, 2, "x"]], 'outer[0].inner[0][2]: is "x"; expected a number'),
        ([], "outer[0].inner: has shape (0,); expected an array of shape (N, 3)"),
        ([[1, 2, [3]]], "outer[0].inner[0][2]: is a list; expected a number"),
    ],
)
def test_wrong_shapes_are_named_with_their_path(value: object, message: str) -> None:
    with pytest.raises(CaptureError) as caught:
        entry(value).array((None, 3))
    assert message in str(caught.value)


def test_unknown_and_missing_keys() -> None:
    with pytest.raises(CaptureError) as caught:
        entry({"sgima": 1, "at": 2}).check_keys(required=("at", "sigma"))
    assert str(caught.value) == (
        'f.json: outer[0].inner.sgima: unknown key (did you mean "sigma"?); expected one of at, sigma'
    )
    with pytest.raises(CaptureError, match=r'inner: "sigma" is missing; expected the keys at, sigma'):
        entry({"at": 2}).check_keys(required=("at", "sigma"))
    with pytest.raises(CaptureError, match=r'inner: "x" is missing'):
        entry({})["x"]
    entry({"at": 2}).check_keys(required=("at",), optional=("sigma",))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"a": 1,\n "b": }', "f.json: line 2 column 7: Expecting value; expected valid JSON"),
        ("", "line 1 column 1"),
        ('{"a": 1', "line 1 column 8"),
        ('{"a": NaN}', "NaN is not JSON; expected finite numbers"),
        ('{"a": [-Infinity]}', "-Infinity is not JSON"),
        ('{"a": 1, "a": 2}', 'key "a" is given twice'),
        (b'{"a": "\xff"}', "byte 7 is not UTF-8"),
        ("[" * 100_000, "expected valid JSON"),
        ('{"a": ' + "9" * 5000 + "}", "expected valid JSON"),
    ],
)
def test_text_that_is_no_document(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(CaptureError) as caught:
        read(tmp_path, text)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="cannot be read"):
        read_document(tmp_path / "none.json")
    assert read(tmp_path, b'\xef\xbb\xbf{"a": 1}')["a"].integer() == 1
