"""Which stages of an image capture are missing, and how they are run."""

import io
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mphygs.capture.format import Markers
from mphygs.capture.stages import STAGES, StageFolder
from mphygs.commands.console import Console
from mphygs.commands.image_stages import StageError, has_stages, missing_stages, recorded_seconds, run_stages
from test_image_capture import recorded


def console() -> Console:
    return Console(io.StringIO())


def names(capture, folder: Path) -> list[str]:
    return [stage.name for stage in missing_stages(capture, folder)]


def test_all_that_is_not_there_is_missing_in_the_order_of_its_use(tmp_path: Path) -> None:
    capture = recorded()
    files = StageFolder(tmp_path)
    assert names(capture, tmp_path) == ["reconstruct", "segment", "register lift", "track lift"]
    bare = replace(capture, sequences=(replace(capture.sequences[0], held=()),))
    assert names(bare, tmp_path) == ["reconstruct", "segment", "register lift", "track lift", "contact lift"]
    given = replace(capture, views=None, gaussians=Path("own.ply"))
    assert names(given, tmp_path) == ["segment", "register lift", "track lift"]
    files.tracks("lift").parent.mkdir(parents=True)
    files.tracks("lift").write_bytes(b"own")
    # what leads to a file of one's own is not needed
    assert names(capture, tmp_path) == ["reconstruct", "segment"]
    assert names(bare, tmp_path) == ["reconstruct", "segment", "contact lift"]
    files.particles.parent.mkdir(parents=True)
    files.particles.write_bytes(b"own")
    assert names(capture, tmp_path) == ["reconstruct"]
    (files.particles.parent / "made.json").write_text(json.dumps({"unfinished": True}))
    assert names(capture, tmp_path) == ["reconstruct", "segment"]


def test_a_capture_with_markers_has_none() -> None:
    capture = recorded()
    assert has_stages(capture)
    markers = Markers(np.zeros((40, 1, 3)), np.zeros((1, 3)), 1e-4)
    seen = replace(capture, views=None, sequences=(replace(capture.sequences[0], markers=markers),))
    assert not has_stages(seen)


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Commands that note how they were called and write what they should."""
    called: list[list[str]] = []

    def command(name: str) -> SimpleNamespace:
        def main(arguments: list[str]) -> int:
            called.append([name, *arguments])
            files = StageFolder(Path(arguments[2]) / STAGES)
            path = {
                "reconstruct": files.gaussians, "segment": files.particles,
                "register": files.pose("lift"), "track": files.tracks("lift"),
            }[name]  # fmt: skip
            if called[0][0] in ("fails", "stopped"):
                return 2 if called[0][0] == "fails" else 130
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(b"made")
            return 0

        return SimpleNamespace(main=main)

    for name in ("reconstruct", "segment", "register", "track"):
        monkeypatch.setitem(sys.modules, f"mphygs.commands.{name}", command(name))
    return called


def test_what_is_missing_is_run_once_and_timed(commands: list, tmp_path: Path) -> None:
    seconds = run_stages(recorded(), Path("flower"), tmp_path, console())
    out = ["flower", "--out", str(tmp_path)]
    assert commands == [
        ["reconstruct", *out],
        ["segment", *out],
        ["register", *out, "--sequences", "lift"],
        ["track", *out, "--sequences", "lift"],
    ]
    assert list(seconds) == ["reconstruct", "segment", "register lift", "track lift"]
    assert run_stages(recorded(), Path("flower"), tmp_path, console()) == recorded_seconds(tmp_path / STAGES)
    assert len(commands) == 4
    StageFolder(tmp_path / STAGES).tracks("lift").unlink()
    run_stages(recorded(), Path("flower"), tmp_path, console())
    assert [call[0] for call in commands[4:]] == ["track"]


def test_a_stage_that_fails_is_named_and_those_before_it_are_kept(commands: list, tmp_path: Path) -> None:
    run_stages(recorded(), Path("flower"), tmp_path, console())
    StageFolder(tmp_path / STAGES).tracks("lift").unlink()
    commands.insert(0, ["fails"])
    with pytest.raises(StageError, match=r"tracks\.npz: was not made by mphygs track"):
        run_stages(recorded(), Path("flower"), tmp_path, console())
    assert StageFolder(tmp_path / STAGES).particles.is_file()


def test_a_stage_that_was_stopped_stops_the_command(commands: list, tmp_path: Path) -> None:
    commands.insert(0, ["stopped"])
    with pytest.raises(KeyboardInterrupt):
        run_stages(recorded(), Path("flower"), tmp_path, console())
    assert len(commands) == 2
