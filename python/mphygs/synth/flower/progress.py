"""How much of making a flower is done: simulations by their substeps, pictures by their number."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mphygs.synth.flower.recording_settings import Shoot
from mphygs.synth.flower.true_motion import SETTLING_ROUNDS, TrueMotion
from mphygs.synth.recipe import Take

# Seconds on one core: of a substep of one block, of a picture, of a pixel of it. Only their ratios matter.
PER_BLOCK, PER_PICTURE, PER_PIXEL = 4e-7, 0.02, 9e-7
# Reports of one stage.
REPORTS = 4


class Progress:
    """Says through `report`, where there is one, the share of the work that is done and what comes now.

    Stages begin in the order in which they are named; what a stage needs counts as done when the next begins.
    """

    def __init__(
        self,
        report: Callable[[float, str], None] | None,
        motion: TrueMotion,
        takes: Sequence[Take],
        shoot: Shoot,
        *,
        compare: bool,
    ) -> None:
        self._report = report
        per_step = PER_BLOCK * motion.blocks
        self._simulation = {t.name if t else "": per_step * motion.substeps(t) for t in (None, *takes)}
        self._picture = PER_PICTURE + PER_PIXEL * shoot.size**2
        simulations = sum(self._simulation.values()) * (2 if compare else 1)
        self._whole = simulations + self._picture * shoot.picture_count
        self._end = 0.0

    def settling(self, text: str) -> Callable[[int], bool]:
        """Begin to settle; what is returned is called with the number of rounds that are done."""
        return self._counting(text, self._simulation[""], SETTLING_ROUNDS)

    def take(self, text: str, take: Take) -> Callable[[int], bool]:
        """Begin a motion; what is returned is called with the number of frames that are done."""
        return self._counting(text, self._simulation[take.name], take.frames)

    def pictures(self, text: str, count: int) -> Callable[[int], bool]:
        """Begin pictures; what is returned is called with the number of those that are done."""
        return self._counting(text, self._picture * count, count)

    def _counting(self, text: str, cost: float, count: int) -> Callable[[int], bool]:
        begin = self._end
        self._end += cost
        told = 0

        def tell(done: int) -> bool:
            nonlocal told
            if REPORTS * done // count > told and done < count:
                told = REPORTS * done // count
                self._say(begin + cost * done / count, f"{text}, {done} of {count}")
            return True

        self._say(begin, text)
        return tell

    def _say(self, done: float, text: str) -> None:
        if self._report:
            self._report(min(done / self._whole, 1.0), text)
