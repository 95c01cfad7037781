"""Cells of a sheet that is fastened over a part of its width: their lengths, and what they show."""

from __future__ import annotations

import numpy as np
import pytest

from bar_capture import bar_belief
from mphygs.capture.meshes import Part
from mphygs.scene.curved_quadrature import lay_chart
from mphygs.scene.fastenings import ACROSS, GROWTH, Fastening, Grading, grading
from mphygs.scene.spacing_worth import spacing_worth, usual_spacing
from mphygs.simulate.modes import natural_modes
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.settings import Settings
from mphygs.synth.thin_shapes import sheet_mesh, strip, thin_flower
from thin_meshes import held_capture

USUAL, WIDTH, THICKNESS = 0.006, 0.008, 3e-4


def graded(width: float = WIDTH) -> Grading:
    """Of a sheet that is fastened between 0.01 and 0.012 m along, 0.02 and 0.028 m across."""
    place = Fastening(np.array([0.01, 0.02]), np.array([0.012, 0.028]), width)
    return Grading(USUAL, (place,), THICKNESS)


@pytest.mark.parametrize("spacing", [0.5 * USUAL, USUAL, 1.7 * USUAL])
def test_cells_at_a_fastening_are_a_share_of_its_width_and_grow_away_from_it(spacing: float) -> None:
    shortest = spacing / USUAL * WIDTH / ACROSS
    for axis, (low, high) in enumerate([(0.01, 0.012), (0.02, 0.028)]):
        inside = graded().length(axis, np.linspace(low, high, 5), spacing)
        assert inside == pytest.approx(np.full(5, shortest))
        away = np.array([1e-3, 2e-3, 0.1])
        for x in (low - away, high + away):
            grown = np.minimum(shortest + GROWTH * away, spacing)
            assert graded().length(axis, x, spacing) == pytest.approx(grown)
    # Never shorter than the sheet is thick, nor longer than the spacing.
    assert graded(1e-6).length(0, np.array([0.011]), USUAL) == pytest.approx([THICKNESS])
    assert graded(1.0).length(0, np.array([0.011]), spacing) == pytest.approx([spacing])


def test_a_stretched_axis_has_cells_of_the_spacing() -> None:
    axis = graded().stretched(0, 0.0, 0.05, USUAL)
    x = np.linspace(0.0, 0.05, 301)
    y = axis(x)
    middle = 0.5 * (x[1:] + x[:-1])
    assert np.diff(y) / np.diff(x) == pytest.approx(USUAL / graded().length(0, middle, USUAL), rel=0.02)
    # In closed form: 2 mm at a quarter of 8 mm; to either side 8 mm of cells that grow from 2 mm to 6 mm.
    grown = USUAL * np.log(6.0 / 2.0) / GROWTH
    assert y[-1] - y[0] == pytest.approx(USUAL + 2.0 * grown + (0.05 - 0.018), rel=1e-3)
    # Beyond its ends it goes on straight, for holds and rims that no sample is on.
    assert axis(np.array([-0.01, 0.06])) == pytest.approx([y[0] - 0.01, y[-1] + 0.01], rel=1e-6)


def test_what_is_fastened_all_along_its_width_has_even_cells() -> None:
    shape = strip()
    usual = usual_spacing(shape.parts)
    assert usual == pytest.approx(spacing_worth(shape.parts, 250), rel=0.03)
    grip = np.stack([np.zeros(9), np.linspace(-0.008, 0.008, 9), np.zeros(9)], axis=1)
    assert grading(shape.parts, 0, usual, [grip]) is None
    # On a grid that has no shorter cells either way they lie where they lay.
    wide = Grading(usual, (Fastening(np.zeros(2), np.zeros(2), 0.016),), 4e-4)
    even, found = (lay_chart(shape.parts[0], usual, [grip], graded) for graded in (None, wide))
    assert np.array_equal(even.count, found.count)
    assert np.allclose(even.control, found.control, rtol=0.0, atol=1e-9)


def test_a_grip_over_a_corner_has_cells_across_it() -> None:
    side = np.linspace(0.0, 0.1, 21)
    place = np.stack([*np.meshgrid(side, side, indexing="ij"), np.zeros((21, 21))], axis=2)
    part = Part("sheet", *sheet_mesh(place, 5e-4), shape="shell")
    across = np.linspace(0.0, 0.008, 9)
    grip = np.array([[x, y, 0.0] for x in across for y in across])
    chart = lay_chart(part, 0.01, [grip], grading([part], 0, 0.01, [grip]))
    s = chart.to_cells(grip)
    assert np.all(np.ptp(s[:, :2], axis=0) > 0.8 * ACROSS)
    cells = chart.nodes.reshape(*chart.control.shape[:3], 3)[1:-1, 1:-1, 1].reshape(-1, 3).astype(float)
    length = np.linalg.norm(chart.jacobian(cells), axis=1)[:, :2]
    assert 0.01 < length.max() < 0.0115 and length.min() < 1.25 * 0.008 / ACROSS


def test_small_places_beside_a_wide_one_ask_for_nothing() -> None:
    """Meshes that overlap touch at many."""
    part = strip().parts[0]
    across = np.stack([np.zeros(9), np.linspace(-0.004, 0.004, 9), np.zeros(9)], axis=1)
    spots = [0.1 * across + [x, 0.0, 0.0] for x in (0.02, 0.04, 0.06)]
    wide, all_of_them = (grading([part], 0, 0.01, grips) for grips in ([across], [across, *spots]))
    assert [one.width for one in all_of_them.fastened] == [one.width for one in wide.fastened]
    alone = grading([part], 0, 0.01, spots)
    assert len(alone.fastened) == 3


def test_the_default_spacing_makes_up_for_cells_at_fastenings() -> None:
    parts = thin_flower(petals=2, grown=0.1).parts
    spacing, usual = spacing_worth(parts, 250), usual_spacing(parts)
    assert 1.05 * spacing < usual < 2.0**0.5 * spacing


def test_petals_swing_as_on_fine_cells() -> None:
    """Two petals 20 mm wide, fastened over 5 mm: on even cells of 4.5 mm they swing a third too fast."""
    shape = thin_flower(petals=2, grown=0.1)
    capture = held_capture(shape.parts, box=shape.hold)
    moduli, density = (list(each.values()) for each in (shape.youngs_modulus, shape.density))
    belief = bar_belief(capture, youngs_modulus=moduli, density=density, poissons_ratio=0.3)
    predictor = Predictor(capture, capture.sequence("a"), Settings(0.0045, dtype="float64", workers=1))
    found = np.sqrt(natural_modes(predictor, belief, 4).squared) / (2.0 * np.pi)
    # On cells of 2 mm, and as much shorter at the joints.
    assert found == pytest.approx([2.97, 2.99, 8.59, 8.94], rel=0.06)
