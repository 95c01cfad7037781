"""Progress: one live line on a terminal, plain lines elsewhere."""

from __future__ import annotations

import io
import os
import pty
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from mphygs.commands.console import Console


def test_elsewhere_every_line_of_progress_stands_by_itself() -> None:
    stream = io.StringIO()
    console = Console(stream, live=True)
    console.progress(0.5, "fine: iteration 2, 1.3 sigma")
    console.working("looking")
    console.say("done")
    console.end()
    first, last = stream.getvalue().splitlines()
    assert re.fullmatch(r"\[ 50 %, .* s, about .* left\] fine: iteration 2, 1.3 sigma", first)
    assert last == "done"


def on_terminal(command: list[str], **environment: str) -> tuple[str, str, int]:
    """What a command writes to a terminal as its standard error, to its standard output, and its code."""
    ours, theirs = pty.openpty()
    heard: list[bytes] = []

    def listen() -> None:
        while True:
            try:
                piece = os.read(ours, 65536)
            except OSError:  # the other side is closed
                return
            if not piece:
                return
            heard.append(piece)

    listener = threading.Thread(target=listen)
    listener.start()
    done = subprocess.run(
        command, stderr=theirs, stdout=subprocess.PIPE, text=True, env={**os.environ, **environment}
    )
    os.close(theirs)
    listener.join(10.0)
    os.close(ours)
    return b"".join(heard).decode(), done.stdout, done.returncode


SCRIPT = """
import sys, time
from mphygs.commands.console import Console
console = Console(sys.stderr, live={live})
console.progress(0.25, "coarse: iteration 0, 3.1 sigma")
time.sleep(0.3)
console.say("a line [of] report")
console.progress(0.5, "fine: iteration 1, 1.0 sigma")
time.sleep(0.3)
console.end()
print("answer")
"""


@pytest.mark.parametrize("live", [True, False])
def test_on_a_terminal_there_is_one_live_line(live: bool) -> None:
    code = [sys.executable, "-c", SCRIPT.format(live=live)]
    heard, answer, status = on_terminal(code, TERM="xterm-256color", COLUMNS="120")
    assert (answer, status) == ("answer\n", 0)
    assert "a line [of] report" in heard and "fine: iteration 1, 1.0 sigma" in heard
    # Redrawn in place, with its share and the time left, and taken away in the end.
    assert ("\x1b[2K" in heard) is live
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", heard)
    assert ("50 %" in shown) and ("left" in shown)
    if live:
        assert shown.count("coarse: iteration 0") >= 2


def test_what_is_at_fault_stands_alone_on_a_terminal(tmp_path: Path) -> None:
    code = [sys.executable, "-m", "mphygs.fit", str(tmp_path / "none")]
    heard, answer, status = on_terminal(code, TERM="xterm-256color")
    assert status == 2 and answer == "" and len(heard.strip().splitlines()) == 1 and "\x1b" not in heard
