"""Few markers whose tracks stand at each other's places: told by the body's slow shapes, and put right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.capture.track_faults.tracks import Finding
from mphygs.simulate.body import hold_boxes
from mphygs.simulate.start_shapes import start_shapes

FAULT = "marker_labels"
# Markers of which all orders are tried.
FEWEST, MOST = 3, 7
# Slow shapes that a motion is told by: fewer numbers than markers have, so that a wrong order shows.
SHAPES = 4
# Of the motion's mean square: what a wrong order leaves at least, and what the right one leaves of that at
# most, in every recording; and of what the next best order leaves, all recordings together.
WRONG, RIGHT, NEXT = 0.25, 0.5, 0.9
# A motion that is smaller than so many standard deviations shows no order.
SMALL = 10.0


def well_labelled(capture: Capture) -> Capture:
    """The capture with the tracks of few markers at the places whose motion they show.

    A body in its holds moves by its slow shapes, most of all. Where another order of the tracks, the same in
    all recordings of these markers, leaves far less than the stated one beside the slowest shapes, each
    marker's displacement from rest goes to the place that moves so; a finding says it. Symmetric bodies that
    look alike in two orders are left as they are.
    """
    groups: dict[bytes, list[Recording]] = {}
    for recording in capture.sequences:
        markers = recording.markers
        if markers is not None and FEWEST <= len(markers.at) <= MOST and recording.held:
            groups.setdefault(np.ascontiguousarray(markers.at).tobytes(), []).append(recording)
    changed = {}
    for own in groups.values():
        order = _order(capture, own)
        if order is not None:
            changed |= {recording.name: _reordered(recording, order) for recording in own}
    if not changed:
        return capture
    return replace(capture, sequences=tuple(changed.get(s.name, s) for s in capture.sequences))


def _order(capture: Capture, recordings: Sequence[Recording]) -> tuple[int, ...] | None:
    """For every place the track that shows its motion, None where the stated order is as good as any."""
    orders = list(permutations(range(len(recordings[0].markers.at))))
    left = []
    for recording in recordings:
        shapes = _columns(capture, recording)
        moved = _displaced(recording)
        moved = moved[np.isfinite(moved).all((1, 2))]
        whole = float(np.mean(moved**2)) if len(moved) else 0.0
        if whole <= (SMALL * recording.markers.sigma) ** 2:
            continue
        basis = np.linalg.qr(shapes)[0]
        rows = moved[:, np.array(orders)].reshape(len(moved), len(orders), -1)
        inside = np.sum((rows @ basis) ** 2, axis=(0, 2))
        left.append(1.0 - inside / np.sum(moved**2))
    if not left:
        return None
    shares = np.array(left)  # (recordings, orders); the stated order is the first
    together = shares.mean(0)
    best = int(together.argmin())
    if best == 0 or (shares[:, 0] < WRONG).any() or (shares[:, best] > RIGHT * shares[:, 0]).any():
        return None
    if np.sort(together)[1] * NEXT < together[best]:
        return None
    return orders[best]


def _columns(capture: Capture, recording: Recording) -> np.ndarray:
    """(3 M, K) displacements of the markers in the slowest shapes."""
    shapes = start_shapes(capture, hold_boxes(recording))
    attachment = shapes.body.attach(recording.markers.at)
    node, value, gradient = shapes.model.weights(attachment.anchor, attachment.cell)
    near = shapes.shape[node][..., :SHAPES]
    moved = np.einsum("mn,mnck->mck", value, near)
    moved += np.einsum("mnj,mnck,mj->mck", gradient, near, attachment.offset)
    moved[attachment.hold >= 0] = 0.0
    return moved.reshape(-1, near.shape[-1])


def _displaced(recording: Recording) -> np.ndarray:
    """(T, M, 3) of the markers from their places at rest, in the frame of the first hold [m]."""
    rotation, shift = _poses(recording)
    position = np.asarray(recording.markers.position, float)
    return (position - shift[:, None]) @ rotation - recording.markers.at


def _poses(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    times = np.arange(len(recording.markers.position)) / recording.fps
    return recording.held[0].poses(times, recording.fps)


def _reordered(recording: Recording, order: tuple[int, ...]) -> Recording:
    """The recording with each track's displacement at the place that moves so."""
    markers = recording.markers
    rotation, shift = _poses(recording)
    moved = _displaced(recording)[:, list(order)]
    position = (moved + markers.at) @ np.swapaxes(rotation, 1, 2) + shift[:, None]
    names = markers.names or tuple(map(str, range(len(order))))
    moves = [f"{names[place]} by {names[track]}" for place, track in enumerate(order) if place != track]
    text = (
        f"tracks stand at each other's places: as the body moves, place {', '.join(moves)}; each "
        "displacement is taken for that of the place that moves so"
    )
    finding = Finding(FAULT, text, {"count": float(len(moves))})
    findings = (*markers.findings, finding)
    return replace(recording, markers=replace(markers, position=position, findings=findings))
