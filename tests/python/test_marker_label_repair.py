"""Few markers whose tracks stand at each other's places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, recorded
from mphygs.capture.format import Capture
from mphygs.fit import marker_label_repair
from mphygs.fit.marker_label_repair import FAULT, well_labelled

FRAMES, LENGTH, SIDE = 30, 0.1, 0.014
SHARES = np.array([[1.0, 0.9, 0.5], [0.8, 0.1, 0.9], [0.6, 0.5, 0.1], [0.25, 0.9, 0.9], [0.4, 0.0, 0.0]])


def shaken(shares: np.ndarray = SHARES, size: float = 0.01) -> Capture:
    """A slender bar of two stiffnesses, shaken in its hold, seen by five markers, noise added."""
    time = np.linspace(0.0, 9.0, FRAMES)
    motion = size * np.stack([0.1 * np.sin(time), np.sin(time), np.sin(1.7 * time)], axis=1)
    capture = bar_capture(
        lengths=(0.05, 0.05), side=SIDE, frames=FRAMES, fps=40.0, motion=motion,
        gravity=np.zeros(3), markers_at=shares * [LENGTH, SIDE, SIDE], fit=(0, FRAMES),
    )  # fmt: skip
    return recorded(capture, bar_belief(capture, youngs_modulus=(2e5, 1e5)), SPACING)


def confused(capture: Capture, order: tuple[int, ...]) -> Capture:
    """The displacements given to other markers: that of track k stands at place order[k]."""
    recording = capture.sequences[0]
    markers, shift = recording.markers, recording.held[0].position[:, None]
    moved = markers.position - shift - markers.at
    position = np.empty_like(moved)
    position[:, list(order)] = moved
    markers = replace(markers, position=position + markers.at + shift)
    return replace(capture, sequences=(replace(recording, markers=markers),))


def test_tracks_that_stand_as_stated_are_left_as_they_are() -> None:
    capture = shaken()
    assert well_labelled(capture) is capture


@pytest.mark.parametrize("order", [(3, 1, 2, 0, 4), (4, 3, 2, 1, 0), (1, 2, 3, 4, 0)])
def test_tracks_at_other_places_are_found_and_put_right(order: tuple[int, ...]) -> None:
    capture = shaken()
    found = well_labelled(confused(capture, order))
    markers = found.sequences[0].markers
    (finding,) = markers.findings
    assert finding.fault == FAULT and finding.numbers["count"] == sum(k != p for k, p in enumerate(order))
    assert f"place 0 by {order[0]}" in finding.text
    np.testing.assert_allclose(markers.position, capture.sequences[0].markers.position, atol=1e-12)


def test_what_is_not_sure_is_left_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    # A motion that noise hides.
    still = confused(shaken(size=1e-4), (4, 3, 2, 1, 0))
    assert well_labelled(still) is still
    # More markers than all orders can be tried of, or too few for their numbers to tell.
    monkeypatch.setattr(marker_label_repair, "MOST", 4)
    wrong = confused(shaken(), (4, 3, 2, 1, 0))
    assert well_labelled(wrong) is wrong


def test_markers_that_move_alike_are_not_exchanged() -> None:
    """Two that sit side by side may change places without a difference: the stated order stands."""
    shares = SHARES.copy()
    shares[1] = shares[0] - [0.02, 0.0, 0.0]
    capture = shaken(shares)
    swapped = confused(capture, (1, 0, 2, 3, 4))
    assert well_labelled(swapped) is swapped
