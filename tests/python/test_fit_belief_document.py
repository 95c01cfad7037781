"""A belief that was kept comes back whole, or not at all."""

import json

import numpy as np
import pytest

from mphygs.fit.belief_document import belief_from_document, document_of_belief
from mphygs.model.belief import Belief


def shaken() -> Belief:
    plain = Belief(parts=("part",), gravity=np.array([0.0, 0.0, -9.81]), parameters=(), terms=())
    return plain.with_effect("base_motion", {"a_y": 3.0, "pulse": 1.0}).with_effect("time_offset")


def test_all_of_a_belief_comes_back() -> None:
    belief = shaken()
    again = belief_from_document(json.loads(json.dumps(document_of_belief(belief))))
    assert again.parameters == belief.parameters and again.terms == belief.terms
    np.testing.assert_array_equal(again.gravity, belief.gravity)


@pytest.mark.parametrize("key", ["base_motion.pulse", "base_motion.f", "time_offset.offset"])
def test_a_parameter_that_is_missing_is_named(key: str) -> None:
    # As in a run that was kept before the effect was given it.
    document = document_of_belief(shaken())
    document["parameters"] = [entry for entry in document["parameters"] if entry["key"] != key]
    with pytest.raises(ValueError, match=f"expected {key} among them"):
        belief_from_document(document)
