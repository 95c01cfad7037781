"""Whatever stands in what commands wrote of their findings, the next one ends with 0 or 2 and one line."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import load_file, save

from any_document import SCRIPT, SETTINGS, mutations, one_line
from command_example import SPACING, answer, call, make_capture
from mphygs.capture.json_values import plain
from mphygs.commands import compare, diagnose, discover, extend, fit, report, view
from mphygs.commands.claim import is_own_file
from mphygs.diagnose.missing_force_document import load_samples, missing_force_text
from mphygs.extend.document_checks import check_models, read_diagnosis, read_steps
from mphygs.extend.loop_record import LoopRecord, read_record, recorded_left_out, restored_ranking
from mphygs.fit.belief_document import belief_from_document
from mphygs.report.page import report_page
from mphygs.report.page_contents import Contents

# A page takes longer than a document.
PAGES = settings(SETTINGS, max_examples=80, deadline=None)


class Folders:
    """A run with a diagnosis and a force, the same extended, and a diagnosis that was stopped; of each the
    page's contents, and of each file what stands in it."""

    def __init__(self, base: Path) -> None:
        self.capture = make_capture(base / "capture")
        self.run, self.extended, self.stopped = base / "run", base / "extended", base / "stopped"
        one = ("--workers", 1)
        answer(fit.main, self.capture, "--out", self.run, "--spacing", SPACING, *one)
        answer(extend.main, self.run, "viscosity", "--out", self.extended, *one)
        with pytest.MonkeyPatch.context() as patch:
            write = diagnose.write_record

            def kept(path: Path, document: dict) -> None:
                write(path, document)
                shutil.copytree(self.run, self.stopped, dirs_exist_ok=True)

            patch.setattr(diagnose, "write_record", kept)
            answer(diagnose.main, self.run, "--effects", "viscosity", "--force", *one)
        pages: list[Contents] = []
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(report, "report_page", lambda own: pages.append(own) or report_page(own))
            for folder in (self.run, self.extended):
                answer(report.main, folder, *one)
        self.plain, self.grown = pages
        self.so_far = self.stopped / diagnose.SO_FAR
        self.diagnosis = self.run / diagnose.DOCUMENT
        self.steps = self.extended / extend.DOCUMENT
        self.force = self.run / "missing-force.safetensors"


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Folders:
    return Folders(tmp_path_factory.mktemp("folders"))


def test_every_finding_is_known_as_written_here(folders: Folders) -> None:
    for path in (folders.diagnosis, folders.so_far, folders.steps, folders.force):
        assert is_own_file(path), path


def document(path: Path) -> dict:
    return json.loads(path.read_text())


def unknown(named: dict) -> dict:
    """The same numbers as they are written where none of them is known."""
    return plain(dict.fromkeys(named, np.inf))


def test_standard_errors_that_nobody_knows_are_written_and_read(folders: Folders, tmp_path: Path) -> None:
    diagnosis, steps, so_far = map(document, (folders.diagnosis, folders.steps, folders.so_far))
    for entry in diagnosis["ranking"]:
        entry["std"] = unknown(entry["std"])
    for number in steps["steps"][-1]["parameters"].values():
        number["std"] = plain(np.inf)
    found = read_diagnosis(put(folders.diagnosis, diagnosis, tmp_path))
    assert found is not None and report_page(replace(folders.plain, diagnosis=found))
    grown = read_steps(put(folders.steps, steps, tmp_path))
    assert grown is not None and report_page(replace(folders.grown, steps=grown))
    state = so_far["rankings"][0]
    assert any(entry["std"] for entry in state["entries"])
    for entry in state["entries"]:
        entry["std"] = unknown(entry["std"])
    kept = read_record(put(folders.so_far, so_far, tmp_path))
    entries = restored_ranking(kept["rankings"][0]).entries
    assert {std for entry in entries for std in entry.std.values()} == {np.inf}


def put(path: Path, content: dict, where: Path) -> Path:
    """A changed document under the name of the true one."""
    where.mkdir(exist_ok=True)
    (where / path.name).write_text(json.dumps(content))
    return where / path.name


def test_steps_that_older_versions_named_otherwise_are_refused(folders: Folders, tmp_path: Path) -> None:
    old = document(folders.so_far)
    for state in old["states"]:
        state["lender"] = state.pop("jacobian_spacing")
    path = put(folders.so_far, old, tmp_path)
    with pytest.raises(ValueError, match=r'states\[0\].*"jacobian_spacing" is missing'):
        read_steps(path)


@given(data=st.data())
@PAGES
def test_any_diagnosis_is_shown_or_refused_in_one_line(
    data: st.DataObject, folders: Folders, tmp_path: Path
) -> None:
    path = put(folders.diagnosis, data.draw(mutations(document(folders.diagnosis))), tmp_path)
    try:
        found = read_diagnosis(path)
    except ValueError as error:
        one_line(error, path)
        return
    told = found.get("missing_force")
    lines = missing_force_text(told, folders.capture, folders.run) if told else ()
    assert all(line.isprintable() for line in lines)
    assert SCRIPT not in report_page(replace(folders.plain, diagnosis=found, force=lines))


@given(data=st.data())
@PAGES
def test_any_steps_are_shown_or_refused_in_one_line(
    data: st.DataObject, folders: Folders, tmp_path: Path
) -> None:
    path = put(folders.steps, data.draw(mutations(document(folders.steps))), tmp_path)
    try:
        found = read_steps(path)
    except ValueError as error:
        one_line(error, path)
    else:
        assert SCRIPT not in report_page(replace(folders.grown, steps=found))


@given(data=st.data())
@SETTINGS
def test_any_steps_are_gone_on_from_or_refused_in_one_line(
    data: st.DataObject, folders: Folders, tmp_path: Path
) -> None:
    path = put(folders.so_far, data.draw(mutations(document(folders.so_far))), tmp_path)
    try:
        found = read_record(path)
        check_models(path, found["states"] if "states" in found else (), folders.plain.capture)
    except ValueError as error:
        one_line(error, path)
        return
    kept = LoopRecord.of(found, path)
    assert len(kept.documents) >= len(kept.states)
    for state in kept.states:
        assert belief_from_document(state["belief"]).parts == ("bar",)
    for frames in recorded_left_out(found).values():
        assert all(frame >= 0 and marker >= 0 for frame, marker in frames)
    for ranking in found.get("rankings", ()):
        assert len(restored_ranking(ranking).entries) == len(ranking["entries"])


def damaged(draw: st.DrawFn, arrays: dict[str, np.ndarray]) -> bytes:
    """Arrays of which one is of another shape, kind or value, or whose file is damaged."""
    key = draw(st.sampled_from(sorted(arrays)))
    array = arrays[key]
    kind = draw(st.sampled_from(["drop", "flat", "short", "kind", "value", "empty", "cut", "flip", "head"]))
    changed = {
        "flat": lambda: array.ravel(),
        "short": lambda: array[:-1].copy(),
        "kind": lambda: array.astype(draw(st.sampled_from([np.float32, np.int64, np.int8, np.float64]))),
        "value": lambda: np.full_like(array, draw(st.sampled_from([-1, 1e300, 0, 1e12]))),
        "empty": lambda: np.zeros((0, *array.shape[1:]), array.dtype),
    }
    rest = {name: other for name, other in arrays.items() if name != key}
    if kind == "drop":
        return save(rest)
    if kind in changed:
        with np.errstate(invalid="ignore"):
            return save(rest | {key: changed[kind]()})
    content = bytearray(save(arrays))
    if kind == "cut":
        return bytes(content[: draw(st.integers(0, len(content) - 1))])
    if kind == "head":
        content[:8] = draw(st.sampled_from([0, 5, 1 << 20, 1 << 40, (1 << 63) - 1])).to_bytes(8, "little")
    else:
        content[draw(st.integers(0, 600))] ^= 1 << draw(st.integers(0, 7))
    return bytes(content)


@given(data=st.data())
@SETTINGS
def test_any_force_is_read_or_refused_in_one_line(
    data: st.DataObject, folders: Folders, tmp_path: Path
) -> None:
    path = tmp_path / folders.force.name
    path.write_bytes(data.draw(st.composite(damaged)(load_file(folders.force))))
    try:
        found = load_samples(tmp_path, {"swing": None, "other": None})
    except ValueError as error:
        one_line(error, path)
        return
    for frames, position, force in found.values():
        assert position.shape == force.shape == (len(frames), position.shape[1], 3)
        assert np.isfinite(position).all() and np.isfinite(force).all() and (frames >= 0).all()


class Unseen:
    """A server that nobody asks."""

    server_address = ("127.0.0.1", 1)

    def serve_forever(self) -> None:
        pass

    def server_close(self) -> None:
        pass


COMMANDS = {
    "compare": ("run", "run.json", lambda folder, _: (compare.main, folder)),
    "report": ("run", "diagnosis.json", lambda folder, _: (report.main, folder)),
    "report-steps": ("extended", "steps.json", lambda folder, _: (report.main, folder)),
    "report-run": ("extended", "run.json", lambda folder, _: (report.main, folder)),
    "view": ("extended", "run.json", lambda folder, _: (view.main, folder, "--port", 0)),
    "diagnose": ("run", "run.json", lambda folder, _: (diagnose.main, folder, "--effects", "viscosity")),
    "resume": ("stopped", diagnose.SO_FAR,
               lambda folder, _: (diagnose.main, folder, "--effects", "viscosity", "--resume")),
    "extend": ("run", "run.json",
               lambda folder, out: (extend.main, folder, "viscosity", "--out", out)),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
@given(data=st.data())
@settings(SETTINGS, max_examples=25, deadline=60_000)
def test_any_folder_ends_a_command_with_one_line(
    data: st.DataObject, folders: Folders, tmp_path: Path, name: str
) -> None:
    kind, file, words = COMMANDS[name]
    source: Path = getattr(folders, kind)
    folder, out = tmp_path / "folder", tmp_path / "out"
    for path in (folder, out):
        shutil.rmtree(path, ignore_errors=True)
    shutil.copytree(source, folder)
    put(source / file, data.draw(mutations(document(source / file))), folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(view, "live_server", lambda *_: Unseen())
        main, *arguments = words(folder, out)
        code, shown, err = call(main, *arguments, "--workers", 1)
    assert code in (0, 2) and "Traceback" not in err
    assert code == 0 or (shown == "" and one_line_at_end(err))


def one_line_at_end(err: str) -> bool:
    last = err.rstrip("\n").split("\n")[-1]
    return last.isprintable() and len(last) < 3000 and "expected" in last


@pytest.mark.slow
@given(data=st.data())
@settings(SETTINGS, max_examples=15, deadline=60_000)
def test_any_loop_is_gone_on_with_or_refused_in_one_line(data: st.DataObject, folders: Folders) -> None:
    out = folders.run.parent / "loop"
    options = (folders.capture, "--out", out, "--effects", "viscosity", "--spacing", SPACING, "--workers", 1)
    if not out.exists():
        answer(discover.main, *options)
    steps = out / extend.DOCUMENT
    before = {path: path.read_bytes() for path in out.glob("*.*")}
    told = document(steps)
    del told["verdict"]
    steps.write_text(json.dumps(data.draw(mutations(told))))
    code, shown, err = call(discover.main, *options, "--resume")
    assert code in (0, 2) and "Traceback" not in err
    assert code == 0 or (shown == "" and one_line_at_end(err))
    for path, content in before.items():
        path.write_bytes(content)
