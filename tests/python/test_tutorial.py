"""The tutorial's commands, run as they stand in docs/tutorial.md."""

import json
import re
import shlex
from pathlib import Path

import pytest

from mphygs.commands.command_table import main

TUTORIAL = Path(__file__).parents[2] / "docs" / "tutorial.md"


def commands() -> list[list[str]]:
    """Every `mphygs ...` line of the tutorial's console blocks, without the program's name."""
    blocks = re.findall(r"```console\n(.*?)```", TUTORIAL.read_text(encoding="utf-8"), re.S)
    return [shlex.split(line)[1:] for block in blocks for line in block.splitlines()]


@pytest.mark.slow
def test_the_tutorial_runs_and_says_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    wanted = commands()
    assert [c[0] for c in wanted] == ["fit", "compare", "diagnose", "extend", "compare", "report"]
    for arguments in wanted:
        assert main(arguments) == 0, (arguments, capsys.readouterr().err[-2000:])
    diagnosis = json.loads(Path("elastic/diagnosis.json").read_text())
    assert (diagnosis["verdict"], diagnosis["effects"]) == ("missing", ["viscosity"])
    before = json.loads(Path("elastic/comparison.json").read_text())
    after = json.loads(Path("viscous/comparison.json").read_text())
    assert not before["adequate"] and after["adequate"]
    for name, ranges in after["sequences"].items():
        for label, error in ranges.items():
            assert error is None or error["rms_over_sigma"] < 1.1, (name, label)
    unseen = [before["sequences"][n]["predict"]["rms_over_sigma"] for n in ("release", "shake")]
    assert min(unseen) > 1.8
    eta = json.loads(Path("viscous/steps.json").read_text())["steps"][-1]["parameters"]["viscosity.eta"]
    truth = json.loads(Path("elastic/capture/answer.json").read_text())["effects"]["viscosity"]["eta"]
    assert abs(eta["value"] - truth) < 0.1 * truth
    assert Path("viscous/report.html").stat().st_size > 100_000
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", TUTORIAL.read_text(encoding="utf-8")):
        assert (TUTORIAL.parent / picture).is_file(), picture
