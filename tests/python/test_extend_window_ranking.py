"""Where candidates are ranked: on the frames where the model is nearly right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from extend_example import (
    SPACING,
    entry_of,
    evaluation_of,
    plain_belief,
    solution_of,
)
from mphygs.diagnose.ranking import Ranking
from mphygs.extend import window_ranking
from mphygs.model.belief import Belief

# An experiment on one core, of which nothing else is asked.
ALONE = SimpleNamespace(settings=SimpleNamespace(workers=1))


def ranking_of(*promises: float) -> Ranking:
    """Effects that promise these shares of what is beyond the noise of 1000 rows."""
    entries = tuple(entry_of("stiffening", 1e5 * share) for share in sorted(promises, reverse=True))
    return Ranking(entries, 1e5 + 1e3, 1000, None, None)


@pytest.mark.parametrize(
    ("names", "asked"),
    [
        (None, ["base_motion", "gravity", "wind"]),
        (["wind", "fibre"], ["wind"]),
        (["fibre", "tether"], ["fibre", "tether"]),
    ],
)
def test_of_other_scales_that_is_taken_at_which_a_load_promises_most(
    names: list[str] | None, asked: Sequence[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scales = [solution_of(plain_belief(), evaluation_of(1e4)) for _ in range(3)]
    promised = {id(scales[0]): 2e3, id(scales[1]): 7e3, id(scales[2]): 5e3}
    by_belief = {id(solution.belief): promised[id(solution)] for solution in scales}

    def rank(
        _e: object, belief: Belief, *_: object, trials: bool, names: Sequence[str], **__: object
    ) -> Ranking:
        assert not trials and list(names) == list(asked)
        entries = entry_of("gravity", 1e2), entry_of("base_motion", by_belief[id(belief)])
        return replace(ranking_of(), entries=entries, chi_square=1e4)

    monkeypatch.setattr(window_ranking, "rank", rank)
    monkeypatch.setattr(window_ranking, "at_other_scales", lambda *_: scales)
    generator = np.random.default_rng(0)
    found = window_ranking._from_soft_materials(ALONE, (0.06, scales[0]), SPACING, generator, names, None)
    assert found is scales[1]
    monkeypatch.setattr(window_ranking, "at_other_scales", lambda *_: [])
    assert (
        window_ranking._from_soft_materials(ALONE, (0.06, scales[0]), SPACING, generator, names, None) is None
    )
