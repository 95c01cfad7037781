"""What the grid gets wrong, by Richardson's extrapolation: against a grid whose error is known."""

from types import SimpleNamespace

import numpy as np
import pytest

from mphygs.diagnose.grid_error import BESIDE, allowance_of, unabsorbed
from mphygs.simulate.errors import SimulationError

SPACING, FRAMES, MARKERS, SIGMA = 0.01, 6, 4, 2e-4


class Grids:
    """An experiment whose predictions are off by `error` times the spacing over SPACING, squared."""

    def __init__(self, error: np.ndarray, *, fails: tuple[float, ...] = ()) -> None:
        self.error, self.fails, self.asked = error, fails, []
        self.observations = {"a": SimpleNamespace(whitener=self._whitener, sensors=())}

    def window(self, spacing: float, share: float) -> SimpleNamespace:
        assert spacing == SPACING
        last = round(share * FRAMES)
        attachment = SimpleNamespace(part=np.arange(MARKERS) % 2)
        return SimpleNamespace(
            ranges={"a": (0, last)}, predictors={"a": SimpleNamespace(attachment=attachment)}
        )

    def predictor(self, name: str, spacing: float) -> SimpleNamespace:
        assert name == "a"
        return SimpleNamespace(predict=lambda belief, last: self._predict(spacing, last))

    def _predict(self, spacing: float, last: int) -> SimpleNamespace:
        self.asked.append(spacing / SPACING)
        if any(abs(spacing / SPACING - ratio) < 1e-9 for ratio in self.fails):
            raise SimulationError("too soft")
        return SimpleNamespace(position=self.position(spacing)[:last], readings=())

    def position(self, spacing: float) -> np.ndarray:
        return self.error * (spacing / SPACING) ** 2

    def _whitener(self, first: int, last: int) -> SimpleNamespace:
        marker = np.tile(np.repeat(np.arange(MARKERS), 3), last - first)
        frame = np.repeat(np.arange(first, last), 3 * MARKERS)
        return SimpleNamespace(
            whiten=lambda a: a.reshape(-1, *a.shape[3:]) / SIGMA, marker=marker, frame=frame
        )

    def evaluation(self, jacobian: np.ndarray) -> SimpleNamespace:
        # Rows of priors follow those of the measurements.
        rows = 3 * FRAMES * MARKERS
        padded = np.concatenate([jacobian, np.ones((2, jacobian.shape[1]))])
        return SimpleNamespace(positions={"a": self.position(SPACING)}, jacobian=padded, data_rows=rows)


@pytest.fixture
def error() -> np.ndarray:
    return 1e-3 * np.random.default_rng(0).standard_normal((FRAMES, MARKERS, 3))


@pytest.mark.parametrize("fails", [(), (1.0 / BESIDE,)])
def test_a_second_order_error_is_found_from_a_finer_or_a_coarser_grid(
    fails: tuple[float, ...], error: np.ndarray
) -> None:
    grids = Grids(error, fails=fails)
    elsewhere = np.zeros((error.size, 1))
    elsewhere[0] = 1.0
    own = unabsorbed(grids, SPACING, None, grids.evaluation(elsewhere))
    expected = error.ravel()[1:] / SIGMA
    assert own == pytest.approx(np.sqrt(expected @ expected / error.size), rel=1e-12)
    assert grids.asked == pytest.approx([1.0 / BESIDE, BESIDE][: 1 + len(fails)])
    spans = allowance_of(grids, SPACING, None, grids.evaluation(elsewhere)).directions
    # The prediction is too large by the error: what it lacks has the other sign, and lies in the span.
    left = error.ravel() - spans @ np.linalg.lstsq(spans, error.ravel(), rcond=None)[0]
    assert np.linalg.norm(left) < 0.8 * np.linalg.norm(error)


def test_what_the_fitted_parameters_take_up_is_not_left(error: np.ndarray) -> None:
    grids = Grids(error)
    absorbs = np.stack([error.ravel(), np.ones(error.size)], 1)
    assert unabsorbed(grids, SPACING, None, grids.evaluation(absorbs)) < 1e-9


def test_no_other_grid_says_nothing(error: np.ndarray) -> None:
    grids = Grids(error, fails=(1.0 / BESIDE, BESIDE))
    evaluation = grids.evaluation(np.ones((error.size, 1)))
    assert unabsorbed(grids, SPACING, None, evaluation) == np.inf
    assert allowance_of(grids, SPACING, None, evaluation).directions is None
