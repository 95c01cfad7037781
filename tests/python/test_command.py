"""The frame of every command."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import scipy.linalg  # noqa: F401  # its own linear algebra is limited as well
from threadpoolctl import threadpool_info, threadpool_limits

from mphygs.commands.command import DONE, FAILED, Answer, run
from mphygs.commands.console import Console
from mphygs.commands.options import CommonOptions


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Say how many threads the linear algebra has."""

    fails: bool = False
    """End with an error."""


def threads() -> list[int]:
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def counted(options: Options, _console: Console) -> Answer:
    if options.fails:
        raise RuntimeError(f"{threads()}")
    return Answer({"threads": threads()}, f"{threads()}")


def test_linear_algebra_leaves_the_cores_to_the_simulation(capsys: pytest.CaptureFixture[str]) -> None:
    with threadpool_limits(2, user_api="blas"):
        assert threads() and set(threads()) == {2}
        assert run(Options, counted, program="count", argv=[]) == DONE
        assert capsys.readouterr().out.strip() == str([1] * len(threads()))
        # Whoever calls a command from Python has theirs back, after an error too.
        assert run(Options, counted, program="count", argv=["--fails"]) == FAILED
        assert str([1] * len(threads())) in capsys.readouterr().err
        assert set(threads()) == {2}
