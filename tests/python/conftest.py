"""Fixtures that many tests share."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

# Side by side, each worker has one core: what is imported after this, and what is started, takes no more.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")

SHARED_DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the shared captures, `../shared/data` beside the repository; skips where it is absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip("the shared data (../shared/data beside the repository) is not here")
    return SHARED_DATA


@pytest.fixture(autouse=True)
def lets_go_of_folders() -> Iterator[None]:
    """What a test holds without a command around it is let go at its end: other tests run in this process."""
    from mphygs.commands import in_use

    with in_use.held():
        yield
