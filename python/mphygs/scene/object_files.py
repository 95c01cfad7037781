"""What later stages read of the object: features.npz, particles.npz and the meshes of its parts, checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mphygs.capture.archives import open_archive
from mphygs.capture.errors import fault
from mphygs.capture.features import Principal, Reduction
from mphygs.capture.meshes import Part, read_mesh, write_mesh
from mphygs.capture.written import replace_arrays
from mphygs.scene.soft_boundary import Particles


@dataclass(frozen=True, eq=False)
class GaussianFeatures:
    """Features of K Gaussians. appearance: (K, D) zD; affinity: (K, A) zA; source: what they came from;
    made_by, reduction: the extractor's name and how its maps become zD, so that other pictures can be held
    against it; "" and None where that is not known."""

    appearance: np.ndarray
    affinity: np.ndarray
    source: str
    made_by: str = ""
    reduction: Reduction | None = None


def write_features(path: Path, features: GaussianFeatures) -> None:
    """Write features.npz."""
    more: dict[str, np.ndarray] = {}
    if features.reduction is not None:
        more["made_by"] = np.array(features.made_by)
        for k, (principal, weight) in enumerate(features.reduction.parts):
            more |= {f"mean_{k}": principal.mean, f"axes_{k}": principal.axes}
            more[f"scale_{k}"] = np.array([principal.scale, weight])
    arrays = {
        "appearance": features.appearance.astype(np.float32),
        "affinity": features.affinity.astype(np.float32),
        "source": np.array(features.source),
    }
    replace_arrays(path, more | arrays)


def read_features(path: Path, count: int) -> GaussianFeatures:
    """The features.npz at `path` of `count` Gaussians. Raises CaptureError where it cannot be used."""
    arrays = _arrays(path, ("appearance", "affinity", "source"))
    appearance = _numbers(path, arrays, "appearance", (count, None))
    affinity = _numbers(path, arrays, "affinity", (count, None))
    reduction = _reduction(path, arrays, appearance.shape[1])
    return GaussianFeatures(
        appearance.astype(np.float32),
        affinity.astype(np.float32),
        str(arrays["source"]),
        made_by="" if reduction is None else str(arrays["made_by"]),
        reduction=reduction,
    )


def _reduction(path: Path, arrays: dict[str, np.ndarray], channels: int) -> Reduction | None:
    """How pictures become the appearance, None where the file does not say."""
    if "made_by" not in arrays:
        return None
    parts = []
    while f"mean_{len(parts)}" in arrays:
        k = len(parts)
        for name in (f"axes_{k}", f"scale_{k}"):
            if name not in arrays:
                raise fault(str(path), f'has no "{name}"', f'one beside "mean_{k}"')
        mean = _numbers(path, arrays, f"mean_{k}", (None,))
        axes = _numbers(path, arrays, f"axes_{k}", (len(mean), None))
        scale, weight = _numbers(path, arrays, f"scale_{k}", (2,))
        if not scale > 0:
            raise fault(f"{path}: scale_{k}", f"is {scale:g}", "a number above zero")
        parts.append((Principal(mean, axes, float(scale)), float(weight)))
    found = sum(principal.axes.shape[1] for principal, _ in parts)
    if found != channels:
        raise fault(f"{path}: axes", f"give {found} channels", f"{channels}, as appearance")
    return Reduction(tuple(parts))


def write_particles(path: Path, particles: Particles) -> None:
    """Write particles.npz."""
    more = {} if particles.pixel is None else {"pixel": np.array(particles.pixel)}
    arrays = {
        "position": particles.position,
        "label": particles.label.astype(np.int32),
        "signed_distance": particles.signed_distance,
        "spacing": np.array(particles.spacing),
        "appearance": particles.appearance.astype(np.float32),
    }
    replace_arrays(path, more | arrays)


def read_particles(path: Path) -> Particles:
    """The particles.npz at `path`. Raises CaptureError where it cannot be used."""
    arrays = _arrays(path, ("position", "label", "signed_distance", "spacing", "appearance"))
    position = _numbers(path, arrays, "position", (None, 3))
    count = len(position)
    label = _numbers(path, arrays, "label", (count,))
    if not (label == np.round(label)).all() or label.min(initial=0) < 0:
        raise fault(f"{path}: label", "holds what is no segment's number", "whole numbers from 0 on")
    names = np.unique(label)
    if len(names) != int(label.max(initial=-1)) + 1:
        raise fault(f"{path}: label", f"has {len(names)} segments up to number {int(label.max())}", "no gaps")
    spacing = float(_numbers(path, arrays, "spacing", ()))
    if not spacing > 0:
        raise fault(f"{path}: spacing", f"is {spacing:g} m", "a length above zero")
    pixel = None
    if "pixel" in arrays:
        pixel = float(_numbers(path, arrays, "pixel", ()))
        if pixel < 0:
            raise fault(f"{path}: pixel", f"is {pixel:g} m", "a length, zero or more")
    return Particles(
        pixel=pixel,
        position=position,
        signed_distance=_numbers(path, arrays, "signed_distance", (count,)),
        spacing=spacing,
        label=label.astype(np.int32),
        appearance=_numbers(path, arrays, "appearance", (count, None)).astype(np.float32),
    )


def segment_name(number: int) -> str:
    """How the segment `number` is called."""
    return f"segment-{number:02d}"


def write_parts(folder: Path, parts: list[Part]) -> None:
    """Write one mesh a part; meshes of other parts that stand there are taken away."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.glob("*.ply"):
        path.unlink()
    for part in parts:
        write_mesh(folder / f"{part.name}.ply", part.vertices, part.faces)


def read_parts(folder: Path) -> list[Part]:
    """The parts in `folder`, in the order of their names. Raises CaptureError where there are none, or one is
    no closed mesh."""
    paths = sorted(folder.glob("*.ply"))
    if not paths:
        raise fault(str(folder), "holds no .ply", "one closed mesh a part")
    return [Part(path.stem, *read_mesh(path)) for path in paths]


def _arrays(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    with open_archive(path, f"an .npz with {', '.join(names)}") as archive:
        for name in names:
            if name not in archive.names:
                raise fault(str(path), f'has no "{name}"', f"an .npz with {', '.join(names)}")
        return {name: archive.read(name) for name in archive.names}


def _numbers(
    path: Path, arrays: dict[str, np.ndarray], name: str, shape: tuple[int | None, ...]
) -> np.ndarray:
    values = arrays[name]
    fits = len(values.shape) == len(shape) and all(
        want is None or have == want for have, want in zip(values.shape, shape, strict=True)
    )
    if not fits or values.dtype.kind not in "fiu":
        wanted = str(tuple("any" if n is None else n for n in shape)).replace("'", "")
        raise fault(f"{path}: {name}", f"is {values.dtype} of shape {values.shape}", f"numbers, {wanted}")
    values = values.astype(np.float64)
    if not np.isfinite(values).all():
        raise fault(f"{path}: {name}", "holds values that are not finite", "numbers")
    return values
