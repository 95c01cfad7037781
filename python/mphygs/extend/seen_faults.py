"""Faults that a measurement shows by itself: they are put right before anything is fitted."""

from __future__ import annotations

from mphygs.capture.track_faults.tracks import Finding
from mphygs.fit.experiment import Experiment

COMMON = "common_shake"
# Noise with what all markers share is this many times the stated one, where that is a fault.
LOUDER = 1.15


def seen_faults(experiment: Experiment) -> dict[str, list[Finding]]:
    """By sequence, of those that are observed: what their tracks showed when they were read, and a noise that
    all markers share where it is more than what is stated."""
    found = {}
    for recording in experiment.capture.sequences:
        name, markers = recording.name, recording.markers
        observation = experiment.observations.get(name)
        if markers is None or observation is None:
            continue
        own = list(markers.findings)
        shared = observation.noise.common_sigma.max()
        if shared > 0.0 and observation.sigma > LOUDER * markers.sigma:
            text = (
                f"all markers jump together from frame to frame, by {1e3 * shared:.3g} mm a coordinate; "
                f"with that noise is {1e3 * observation.sigma:.3g} mm, stated {1e3 * markers.sigma:.3g} mm"
            )
            own.append(Finding(COMMON, text, {"sigma": float(shared)}))
        found[name] = own
    return found


def fault_names(found: dict[str, list[Finding]]) -> list[str]:
    """Their names, each once."""
    return list(dict.fromkeys(finding.fault for own in found.values() for finding in own))


def fault_lines(found: dict[str, list[Finding]]) -> list[str]:
    """What is to be said of them."""
    return [
        f"'{name}': {finding.fault}: {finding.text}" for name, own in found.items() for finding in own
    ]
