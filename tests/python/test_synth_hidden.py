"""Every effect, fault and cause that can be hidden changes the data."""

import numpy as np
import pytest

from mphygs.model.registry import effects, laws
from mphygs.synth.hidden import hidden_names
from synth_example import SIGMA, made, tracks


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Tracks of the object with nothing hidden in it."""
    _, capture = made(tmp_path_factory.mktemp("plain"), "two-part-bar", measure_signal=False)
    return tracks(capture)


def test_everything_of_the_registry_that_is_fitted_can_be_hidden() -> None:
    """Faults that tracks show by themselves are put on by their own tests: no model has them."""
    fitted = {name for name, spec in effects().items() if spec.fitted}
    assert (fitted | {"marker_outliers"}) - {"prestress"} <= set(hidden_names())
    assert {"cubic_drag", "point_field", "actuation"} <= set(hidden_names())


@pytest.mark.parametrize("name", hidden_names())
def test_what_is_hidden_changes_the_data(name, plain, tmp_path) -> None:
    result, capture = made(tmp_path, "two-part-bar", (name,))
    # The noise has the same seed and falls out of the difference.
    difference = np.nan_to_num(tracks(capture) - plain)
    # Laws are alike where strains are small.
    least = 0.1 if name in laws() else 0.5
    assert np.abs(difference).max() > least * SIGMA
    assert np.isfinite(difference).all()
    hidden = result.answer["hidden"][0]
    assert hidden.removeprefix("unknown:") == name
    assert hidden.startswith("unknown:") == (name not in effects())
