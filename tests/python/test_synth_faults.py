"""Faults change what is seen by what they say."""

import numpy as np
import pytest

from mphygs.synth.faults import fault_values, seen_through, shifted
from synth_example import made, tracks

TIMES = np.arange(40) / 40.0


def swing(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (T, 5, 3) of points that swing."""
    phase = 6.0 * times[:, None, None] + np.arange(15).reshape(5, 3)
    return 0.1 * np.sin(phase), 0.6 * np.cos(phase)


def see(faults: dict, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    values = {name: fault_values(name, given) for name, given in faults.items()}
    return seen_through(
        swing(TIMES)[0], TIMES, values, np.array([1, 1, 1, 0, 0], bool), np.random.default_rng(seed)
    )


def test_shifted_tracks_are_the_state_at_other_times() -> None:
    later = shifted(TIMES, *swing(TIMES), TIMES[:-2] + 0.013)
    assert later == pytest.approx(swing(TIMES[:-2] + 0.013)[0], abs=1e-6)
    early = shifted(TIMES, *swing(TIMES), TIMES - 0.013)
    assert early[0] == pytest.approx(swing(TIMES[:1])[0][0])
    with pytest.raises(ValueError, match="at most"):
        shifted(TIMES, *swing(TIMES), TIMES + 0.013)


def test_length_scale_and_drift() -> None:
    true = swing(TIMES)[0]
    assert see({"length_scale": {"scale": 0.03}})[0] == pytest.approx(1.03 * true)
    drifted = see({"frame_drift": {"v_x": 0.02, "v_z": -0.01}})[0] - true
    assert drifted[-1] == pytest.approx(np.tile(TIMES[-1] * np.array([0.02, 0.0, -0.01]), (5, 1)))
    turned = see({"frame_drift": {"w_z": 0.5}})[0]
    assert np.linalg.norm(turned, axis=2) == pytest.approx(np.linalg.norm(true, axis=2))
    angle = 0.5 * TIMES[-1]
    x, y = true[-1, :, 0], true[-1, :, 1]
    assert turned[-1, :, 0] == pytest.approx(np.cos(angle) * x - np.sin(angle) * y)


def test_outliers_walk_away_and_only_movable_markers_do() -> None:
    seen, lost = see({"marker_outliers": {"count": 2.0}})
    moved = np.abs(seen - swing(TIMES)[0]).max(axis=(0, 2))
    assert len(lost) == 2 and set(lost) < {0, 1, 2}
    assert (moved[lost] > 1e-3).all()
    assert (np.delete(moved, lost) == 0.0).all()
    with pytest.raises(ValueError, match="expected 1 to 3"):
        see({"marker_outliers": {"count": 4.0}})


def test_unknown_faults_and_numbers_are_refused() -> None:
    with pytest.raises(ValueError, match="expected one of time_offset"):
        fault_values("smoke", {})
    with pytest.raises(ValueError, match="has no 'scale'"):
        fault_values("time_offset", {"scale": 1.0})
    assert fault_values("frame_drift", {"v_y": 2.0})["v_x"] == 0.0


def test_a_time_offset_in_a_capture_is_the_motion_of_another_time(tmp_path) -> None:
    frame = 1.0 / 60.0
    _, plain = made(tmp_path / "plain", "bar", noise_free=True)
    _, late = made(tmp_path / "late", "bar", (f"time_offset:offset={frame}",), noise_free=True)
    assert tracks(late)[:-1] == pytest.approx(tracks(plain)[1:], abs=1e-5)
    assert np.abs(tracks(late) - tracks(plain)).max() > 1e-3
