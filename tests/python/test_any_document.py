"""Whatever stands in a capture's or a run's document, a command ends with 0 or 2 and one line."""

from __future__ import annotations

import json
import resource
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from any_document import SETTINGS, mutations, one_line
from capture_example import Example
from command_example import SPACING, answer, call, make_capture
from mphygs.capture.errors import CaptureError
from mphygs.capture.format import load_capture
from mphygs.commands import fit
from mphygs.fit.of_run import experiment_of
from mphygs.fit.run import load_run

GIGABYTE = 1 << 30


@pytest.fixture(autouse=True)
def frugal() -> Iterator[None]:
    """No more memory than a good document takes, and a gigabyte."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + GIGABYTE, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Example:
    made = Example(tmp_path_factory.mktemp("example"))
    made.write()
    return made


@given(data=st.data())
@SETTINGS
def test_any_capture_is_read_or_refused_in_one_line(data: st.DataObject, example: Example) -> None:
    document = data.draw(mutations(example.document))
    (example.folder / "capture.json").write_text(json.dumps(document))
    try:
        capture = load_capture(example.folder)
    except CaptureError as error:
        one_line(error, example.folder)
    else:
        assert capture.name.isprintable()
        for part in capture.parts:
            assert np.isfinite(part.vertices).all() and part.volume > 0
        for recording in capture.sequences:
            assert 0.1 <= recording.fps <= 1e6 and "/" not in recording.name


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """A finished run beside its capture, and its document."""
    folder = tmp_path_factory.mktemp("finished")
    capture = make_capture(folder / "capture")
    run = folder / "run"
    answer(fit.main, capture, "--effects", "viscosity", "--out", run, "--spacing", SPACING, "--workers", 1)
    return run, json.loads((run / "run.json").read_text())


@given(data=st.data())
@SETTINGS
def test_any_run_is_read_or_refused_in_one_line(data: st.DataObject, finished: tuple[Path, dict]) -> None:
    run, document = finished
    (run / "run.json").write_text(json.dumps(data.draw(mutations(document))))
    before = sorted(path.name for path in run.iterdir())
    try:
        experiment, belief = experiment_of(load_run(run))
    except ValueError as error:
        line = str(error)
        assert line.isprintable() and len(line) < 3000 and "expected" in line, line
    else:
        assert set(experiment.fitted) <= {"swing", "other"} and belief.parts == ("bar",)
    assert sorted(path.name for path in run.iterdir()) == before


@given(content=st.one_of(st.binary(max_size=200), st.text(max_size=200).map(str.encode)))
@SETTINGS
def test_any_bytes_are_refused_in_one_line(
    content: bytes, example: Example, finished: tuple[Path, dict]
) -> None:
    run, _ = finished
    (run / "run.json").write_bytes(content)
    with pytest.raises(ValueError) as caught:
        load_run(run)
    one_line(caught.value, run)
    (example.folder / "capture.json").write_bytes(content)
    with pytest.raises(CaptureError) as caught:
        load_capture(example.folder)
    one_line(caught.value, example.folder)


@given(data=st.data())
@settings(SETTINGS, max_examples=40, deadline=None)
def test_any_capture_ends_the_command_with_one_line(
    data: st.DataObject, example: Example, tmp_path: Path
) -> None:
    """The whole command, as far as the point where it would begin to fit."""
    (example.folder / "capture.json").write_text(json.dumps(data.draw(mutations(example.document))))
    code, out, err = call(
        fit.main, example.folder, "--out", tmp_path / "run", "--frames", "bad", "--workers", 1
    )
    assert (code, out) == (2, "") and err.count("\n") == 1 and "Traceback" not in err
    assert err.rstrip("\n").isprintable() and not (tmp_path / "run").exists()
    shutil.rmtree(tmp_path / "run", ignore_errors=True)
