"""`synth flower`: several species by one command, progress, exit codes."""

import json

import pytest

from mphygs.capture.format import load_capture
from mphygs.commands.synth import main

SMALL = ["--size", "32", "--rest-views", "4", "--cameras", "2", "--frames", "8", "--tracks", "20"]
COARSE = ["--spacing-share", "1.9"]


@pytest.mark.slow
def test_one_command_makes_several_species(tmp_path, capsys) -> None:
    out = tmp_path / "flowers"
    asked = ["flower", "--out", str(out), "--species", "buttercup", "--species", "crocus", "--noise", "0.02"]
    assert main([*asked, *SMALL, *COARSE, "--json"]) == 0
    heard = capsys.readouterr()
    answer = json.loads(heard.out)
    assert [f["species"] for f in answer["flowers"]] == ["buttercup", "crocus"]
    assert "left]" in heard.err and "crocus: turned: pictures" in heard.err
    for flower in answer["flowers"]:
        assert load_capture(flower["capture"]).name == flower["species"]
    # all is there already: told at once, and the same
    assert main([*asked, *SMALL, *COARSE]) == 0
    assert "buttercup: stem, receptacle" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--species", "pear"], "'pear'; expected all, or some of daisy"),
        (["--hidden", "smoke"], "'smoke'"),
        (["--frames", "3"], "--frames: got 3: expected 8 or more"),
        (["--rest-views", "1"], "--rest-views: got 1"),
        (["--sigma", "1"], "sigma"),
    ],
)
def test_bad_options_end_in_one_line_and_exit_code_2(options, said, tmp_path, capsys) -> None:
    assert main(["flower", "--out", str(tmp_path / "x"), *options]) == 2
    heard = capsys.readouterr()
    assert heard.out == "" and said in heard.err and heard.err.count("\n") == 1
    assert not (tmp_path / "x").exists()


def test_the_kind_comes_first_and_the_flower_of_prisms_has_a_name(tmp_path, capsys) -> None:
    assert main(["--out", str(tmp_path / "x"), "flower"]) == 2
    assert "the kind first" in capsys.readouterr().err
    out = tmp_path / "prisms"
    asked = ["prism-flower", "--out", str(out), "--frames", "8", "--markers", "20", "--spacing-share", "1.5"]
    assert main(asked) == 0
    assert len(load_capture(out).parts) == 4
