"""Cells of which material fills little: what their points do not see takes no part in the motion."""

from __future__ import annotations

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.simulate import discretisation
from mphygs.simulate.body import hold_boxes
from mphygs.simulate.modes import natural_modes
from mphygs.simulate.prediction import Predictor, Settings


def frequencies(spacing: float, count: int) -> np.ndarray:
    """The lowest natural frequencies of a slender bar [Hz]."""
    capture = bar_capture(lengths=(0.06,), side=0.0085, depth=0.008, gravity=np.zeros(3))
    belief = bar_belief(capture, youngs_modulus=5e4, density=1000.0, prestress="off")
    recording = capture.sequences[0]
    # A grid that does not fit the bar: one that does has no sparse cells.
    cut = discretisation.discretise(capture, hold_boxes(recording), spacing, fitting=False)
    settings = Settings(spacing, dtype="float64", workers=1)
    predictor = Predictor(capture, recording, settings, body=cut)
    assert predictor.body.geometry["sparse"].any() == (discretisation.SPARSE > 0.0)
    return np.sqrt(np.maximum(natural_modes(predictor, belief, count).squared, 0.0)) / (2 * np.pi)


@pytest.mark.parametrize("spacing", [0.0058, 0.0062, 0.0066])
def test_no_mode_is_as_slow_as_the_bars_own(spacing: float, monkeypatch: pytest.MonkeyPatch) -> None:
    # Of a cantilever: the lowest two are its bending to either side, the next ones four times as fast.
    found = frequencies(spacing, 4)
    np.testing.assert_allclose(found[:2], [2.50, 2.65], rtol=5e-3)
    assert found[2] > 3.5 * found[0]
    monkeypatch.setattr(discretisation, "SPARSE", 0.0)
    without = frequencies(spacing, 4)
    assert without[2] < 1.2 * found[0], "without springs there are slower ones, or as slow"


def test_a_sheet_much_thinner_than_a_cell_has_no_springs() -> None:
    for depth, some in ((0.001, False), (0.008, True)):
        capture = bar_capture(lengths=(0.06,), side=0.0085, depth=depth)
        found = discretisation.discretise(capture, hold_boxes(capture.sequences[0]), 0.0058, fitting=False)
        sparse = found.geometry["sparse"]
        assert sparse.any() == some
        between = (sparse >= discretisation.SMALLEST_SHARE) & (sparse < discretisation.SPARSE)
        assert ((sparse == 0.0) | between).all()


@pytest.mark.parametrize("spacing", [0.0073, 0.0085, 0.0097])
def test_a_bar_of_one_cell_to_a_section_has_two_and_springs(
    spacing: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture = bar_capture(lengths=(0.06,), side=0.0085, depth=0.008, gravity=np.zeros(3))
    belief = bar_belief(capture, youngs_modulus=5e4, density=1000.0, prestress="off")
    recording, settings = capture.sequences[0], Settings(spacing, dtype="float64", workers=1)

    def slowest(count: int) -> np.ndarray:
        made = discretisation.discretise(capture, hold_boxes(recording), spacing)
        assert sorted(np.ptp(made.quadrature.cell, axis=0) + 1)[:2] == [1, 2]
        assert made.geometry["sparse"].any() == (discretisation.NARROW > 0)
        predictor = Predictor(capture, recording, settings, body=made)
        return np.sqrt(np.maximum(natural_modes(predictor, belief, count).squared, 0.0)) / (2 * np.pi)

    found = slowest(3)
    np.testing.assert_allclose(found[:2], [2.50, 2.65], rtol=1e-2)
    assert found[2] > 3.5 * found[0]
    monkeypatch.setattr(discretisation, "NARROW", 0)
    monkeypatch.setattr(discretisation, "SPARSE", 0.0)
    assert slowest(3)[2] < 1.2 * found[0]


def test_a_grid_that_fits_a_bar_has_full_cells_and_its_own_spacing() -> None:
    capture = bar_capture(lengths=(0.06, 0.033), side=0.0085, depth=0.008)
    boxes = hold_boxes(capture.sequences[0])
    found = discretisation.discretise(capture, boxes, 0.005)
    np.testing.assert_allclose(found.quadrature.filled, 1.0, rtol=1e-9)
    np.testing.assert_allclose(
        found.quadrature.spacings, [[0.06 / 12, 0.00425, 0.004], [0.033 / 7, 0.00425, 0.004]]
    )
    # What the hold encloses is not part of it.
    assert found.quadrature.volumes.sum() == pytest.approx(0.093 * 0.0085 * 0.008, rel=1e-9)
    common = discretisation.discretise(capture, boxes, 0.005, fitting=False)
    assert common.quadrature.volumes.sum() == pytest.approx(0.093 * 0.0085 * 0.008, rel=1e-9)


def test_both_kinds_of_grid_swing_alike() -> None:
    # Grids of other spacings and places, tied at the joint: the lowest two modes are the bar's, not theirs.
    capture = bar_capture(lengths=(0.04, 0.033), side=0.012, depth=0.011, gravity=np.zeros(3))
    belief = bar_belief(capture, youngs_modulus=5e4, density=1000.0, prestress="off")
    recording, settings = capture.sequences[0], Settings(0.0052, dtype="float64", workers=1)
    found = []
    for fitting in (True, False):
        made = discretisation.discretise(capture, hold_boxes(recording), 0.0052, fitting=fitting)
        predictor = Predictor(capture, recording, settings, body=made)
        found.append(np.sqrt(natural_modes(predictor, belief, 2).squared))
    np.testing.assert_allclose(found[0], found[1], rtol=4e-3)
