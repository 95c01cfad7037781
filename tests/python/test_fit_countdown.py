"""How much of a stage is done, and what is told of the rest."""

from __future__ import annotations

import pytest

from mphygs.fit import countdown
from mphygs.fit.countdown import Countdown, Pieces, duration


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.2, "0 s"), (99.4, "99 s"), (150.0, "2 min"), (7200.0, "2.0 h")]
)
def test_a_time_is_told_in_words_of_one_glance(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_the_rest_takes_as_long_as_the_work_so_far_says(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter([100.0, 106.0, 120.0])
    monkeypatch.setattr(countdown.time, "monotonic", lambda: next(now))
    said: list[str] = []
    stage = Countdown(said.append, "refits begun", 8.0)
    stage.done(2.0)
    # Less is left than was thought.
    stage.done(2.0, left=1.0)
    # Nothing is left to be told.
    stage.done(1.0)
    assert said == [
        "refits begun: 25% done, about 18 s left of it",
        "refits begun: 80% done, about 5 s left of it",
    ]


def test_nobody_need_listen() -> None:
    Countdown(None, "refits begun", 2.0).done(1.0)


def test_pieces_are_told_as_one_whole() -> None:
    told: list[tuple[float, str]] = []
    pieces = Pieces(lambda share, line: told.append((share, line)), {"fit": 6.0, "skipped": 0.0, "rest": 2.0})
    fit, rest = pieces.shares("fit"), pieces.lines("rest", 2)
    fit(0.5, "half of it")
    fit(1.2, "all of it, and more")
    for line in ("first", "second", "one more than was expected"):
        rest(line)
    shares = [share for share, _ in told]
    assert shares == pytest.approx([0.375, 0.75, 0.75, 0.875, 1.0])
    assert [line for _, line in told[-2:]] == ["second", "one more than was expected"]
