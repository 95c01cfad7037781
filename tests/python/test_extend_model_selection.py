"""Which refits are asked on the grid that decides."""

from extend_example import assessment_of, refit_of
from mphygs.extend.grids import GROSS
from mphygs.extend.model_selection import MAY_BE_THE_GRIDS, RIVALS, best_and_rivals
from mphygs.extend.refit import Refit
from mphygs.extend.step import EXPLAINED


def left(*ratios: float) -> Refit:
    return refit_of(gain=None, assessment=assessment_of(*ratios))


def test_what_a_coarse_grid_may_leave_of_a_right_model_is_a_rival() -> None:
    best, near, far = left(1.04), left(MAY_BE_THE_GRIDS - 0.01), left(MAY_BE_THE_GRIDS + 0.01)
    assert best_and_rivals([far, best, near]) == (best, [near])
    # A model at the noise says that the grid has nothing of its own here.
    noise, explained = left(1.02), left(EXPLAINED - 0.01)
    assert best_and_rivals([near, noise, explained]) == (noise, [explained])
    # One range that no grid excuses is enough, however good the others are.
    assert best_and_rivals([best, left(1.0, 1.5)]) == (best, [])


def test_where_none_explains_it_all_are_rivals_that_a_finer_grid_would_be_asked_for() -> None:
    best, near, far = left(1.4), left(GROSS - 0.01), left(GROSS + 0.01)
    assert best_and_rivals([far, near, best]) == (best, [near])


def test_rivals_of_what_explains_little_are_those_that_explain_nearly_as_much() -> None:
    best, near, far = left(3.1), left(4.1), left(4.4)
    assert best_and_rivals([far, near, best]) == (best, [near])


def test_so_many_rivals_are_asked_at_most() -> None:
    refits = [left(1.0 + 0.01 * k) for k in range(2 * RIVALS)]
    best, rivals = best_and_rivals(refits[::-1])
    assert best is refits[0] and rivals == refits[1 : 1 + RIVALS]
