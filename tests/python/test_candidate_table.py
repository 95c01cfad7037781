"""What a round of the loop says of its candidates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from extend_example import assessment_of, entry_of, plain_belief, step_of
from mphygs.capture.json_values import plain
from mphygs.diagnose.ranking import Ranking, unsimulated
from mphygs.extend.candidate_table import candidate_rows, path_rows, path_text, table_text


def test_every_candidate_has_a_row_with_its_fate() -> None:
    before = plain_belief()
    # A direction that the data do not tell has no standard error.
    open_ = replace(entry_of("gravity", 50.0), estimate={"delta_g_x": 0.1}, std={"delta_g_x": np.inf})
    entries = (
        entry_of("viscosity", 900.0),
        open_,
        entry_of("wind", 400.0),
        unsimulated("relaxation", "relaxation", "no stable substep", before, 3.0),
    )
    step = replace(step_of(assessment_of(1.0)), added=("viscosity",), ties=("wind",))
    fates = {"gravity": "promises too little"}
    rows = candidate_rows(Ranking(entries, 1e3, 100, None), [], fates, before, step)
    told = {row["effect"]: row for row in plain(list(rows))}
    assert list(told) == ["viscosity", "gravity", "wind", "relaxation"]
    struck = [row["struck"] for row in told.values()]
    assert struck == [None, "promises too little", None, "no stable substep"]
    assert told["viscosity"]["ties"] == ["wind"] and told["wind"]["ties"] == ["viscosity"]
    assert told["gravity"]["std"] == {} and told["gravity"]["estimate"] == {"delta_g_x": 0.1}
    lines = table_text(list(told.values()))
    assert sum(any(name in line for line in lines) for name in told) == 4
    assert "no stable substep" in "\n".join(lines) and table_text([]) == []


def error(ratio: float, count: int) -> dict[str, float]:
    return {"rms": 1e-3, "max": 1e-3, "rms_over_sigma": ratio, "count": count}


def test_the_path_pools_the_recordings_and_tells_the_fall() -> None:
    first = {
        "effects": [], "added": [], "adequate": False, "p_value": 0.0, "grid": None,
        "sequences": {
            "a": {"fit": error(3.0, 30), "predict": None}, "b": {"fit": error(1.0, 10), "predict": None},
        },
    }  # fmt: skip
    second = first | {
        "effects": ["wind"], "added": ["wind"], "adequate": True, "p_value": 0.4, "grid": 0.2,
        "sequences": {"a": {"fit": error(1.0, 40), "predict": error(1.2, 10)}},
    }  # fmt: skip
    rows = path_rows([first, second])
    pooled = np.sqrt((30 * 9.0 + 10) / 40)
    assert np.isclose(rows[0]["fitted"], pooled) and rows[0]["unseen"] is None
    assert np.isclose(rows[1]["fitted_fall"], 1.0 - 1.0 / pooled) and rows[1]["unseen_fall"] is None
    text = "\n".join(path_text(rows))
    assert "elasticity alone" in text and "wind" in text and "0.20" in text
