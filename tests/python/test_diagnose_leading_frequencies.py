"""Which frequencies a course in time swings at."""

import numpy as np
import pytest

from mphygs.diagnose.leading_frequencies import swing_frequencies

FPS, FRAMES = 50.0, 100


def course(*waves: tuple[float, float]) -> np.ndarray:
    """(T, 2): the waves (frequency, amplitude), the first on the first channel, the others on the second."""
    time = np.arange(FRAMES) / FPS
    out = np.full((FRAMES, 2), 3.0)
    for k, (frequency, amplitude) in enumerate(waves):
        out[:, min(k, 1)] += amplitude * np.sin(2 * np.pi * frequency * time)
    return out


def test_the_strongest_come_first() -> None:
    assert swing_frequencies(course((4.0, 1.0), (9.0, 2.0)), FPS, 2) == pytest.approx([9.0, 4.0])
    assert swing_frequencies(course((4.0, 2.0), (9.0, 1.0)), FPS, 1) == pytest.approx([4.0])


def test_what_a_strong_one_spreads_to_its_neighbours_is_no_other_one() -> None:
    # The spectrum's step is 0.5 Hz; the taper spreads 4 Hz to 3.5 and 4.5, which are stronger than 9 Hz.
    assert swing_frequencies(course((4.0, 1.0), (9.0, 0.1)), FPS, 2) == pytest.approx([4.0, 9.0])


def test_a_strong_one_between_two_steps_hides_no_weak_one() -> None:
    # Without the taper the strong one leaks more to its surroundings than the weak one has.
    found = swing_frequencies(course((4.25, 1.0), (15.0, 0.05)), FPS, 2)
    assert found == pytest.approx([4.25, 15.0], abs=0.26)


def test_a_drift_is_no_swing() -> None:
    slow = course((4.0, 0.1))
    slow[:, 0] += 10.0 * np.arange(FRAMES) / FPS
    assert 0.5 not in swing_frequencies(slow, FPS, 3)
    assert swing_frequencies(np.ones((FRAMES, 3)), FPS, 2) == []
