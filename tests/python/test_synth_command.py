"""The synth command: one JSON object, exit codes, a capture that loads."""

import json

import pytest

from mphygs.capture.format import load_capture
from mphygs.commands.synth import main

SMALL = ["--frames", "12", "--markers", "20", "--spacing-share", "1.5"]


def test_the_command_writes_a_capture_and_says_what_is_hidden(tmp_path, capsys) -> None:
    out = tmp_path / "capture"
    options = [
        "two-part-bar",
        "--hidden",
        "air_drag:c_d=4",
        "--fault",
        "length_scale",
        "--out",
        str(out),
        "--seed",
        "2",
    ]
    assert main([*options, "--noise", "correlated", "--motion", "rock,turn", "--json", *SMALL]) == 0
    heard = capsys.readouterr()
    answer = json.loads(heard.out)
    assert answer["hidden"] == ["air_drag", "length_scale"]
    assert answer["effects"]["air_drag"]["c_d"] == 4.0
    assert "%" in heard.err
    capture = load_capture(answer["capture"])
    assert [s.frames for s in capture.sequences] == [12, 12]
    truth = json.loads((out / "answer.json").read_text())
    assert truth["noise"]["kind"] == "correlated"
    assert [m["kind"] for m in truth["motions"][0]] == ["rock", "turn"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["pear"], "two-part-bar"),
        (["bar", "--hidden", "smoke"], "'smoke'"),
        (["bar", "--fault", "viscosity"], "--fault"),
        (["bar", "--frames", "3"], "8 or more"),
        (["bar", "--sigma", "0"], "above 0"),
        (["bar", "--motion", "jump"], "'jump'"),
        (["bar", "--markers", "2"], "at least 4"),
        (["bar", "--spacing-share", "9"], "0.3 to 2"),
    ],
)
def test_bad_options_end_in_one_line_and_exit_code_2(options, said, tmp_path, capsys) -> None:
    assert main([*options, "--out", str(tmp_path / "x")]) == 2
    heard = capsys.readouterr()
    assert heard.out == ""
    assert said in heard.err and heard.err.count("\n") == 1
    assert not (tmp_path / "x" / "answer.json").exists()


def test_nothing_but_an_older_capture_of_its_own_is_written_over(tmp_path, capsys) -> None:
    out = tmp_path / "own"
    out.mkdir()
    (out / "capture.json").write_text("mine")
    for place in (out, out / "capture.json", out / "capture.json" / "x"):
        assert main(["bar", "--out", str(place), *SMALL]) == 2
        heard = capsys.readouterr()
        assert f"--out {place}" in heard.err and heard.err.count("\n") == 1
    assert [p.read_text() for p in out.iterdir()] == ["mine"]
    for seed in ("0", "1"):
        assert main(["bar", "--out", str(tmp_path / "made"), "--seed", seed, *SMALL]) == 0
    (tmp_path / "made" / "run.json").write_text("{}")
    assert main(["bar", "--out", str(tmp_path / "made"), *SMALL]) == 2


def test_people_are_told_what_to_run_next(tmp_path, capsys) -> None:
    assert main(["bar", "--out", str(tmp_path / "c"), *SMALL]) == 0
    assert "mphygs discover" in capsys.readouterr().out
