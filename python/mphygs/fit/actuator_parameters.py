"""Unknown numbers of a capture's actuators: how much of what is stated arrives, and how late."""

from __future__ import annotations

from mphygs.capture.format import Capture
from mphygs.model.belief import Parameter
from mphygs.model.registry import effects
from mphygs.simulate.actuation import DELAY, GAIN

# Friction, leaks and units of drives: a factor about 1; a delay of some frames of a bus or a valve.
GAIN_RANGE, GAIN_SPREAD = (1e-2, 1e2), 1.0
DELAY_MOST = 0.5


def actuator_parameters(capture: Capture) -> list[Parameter]:
    """Gain [-] and delay [s] of every actuator that has them unknown; actuators of one name share them.

    Raises ValueError for a name that an effect has.
    """
    found: dict[str, Parameter] = {}
    for recording in capture.sequences:
        for actuator in recording.actuators:
            if actuator.unknown and actuator.name in effects():
                raise ValueError(
                    f"sequence '{recording.name}': load '{actuator.name}' is named as an effect; expected a "
                    "name of its own"
                )
            frame = 1.0 / recording.fps
            for quantity in actuator.unknown:
                key = f"{actuator.name}.{quantity}"
                if quantity == GAIN:
                    found[key] = Parameter(key, 1.0, "-", *GAIN_RANGE, log=True, prior_std=GAIN_SPREAD)
                elif quantity == DELAY:
                    found[key] = Parameter(key, 0.0, "s", -DELAY_MOST, DELAY_MOST, scale=frame)
    return list(found.values())
