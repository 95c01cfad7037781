"""From a species and a seed to a capture in pictures, with its truth beside it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from mphygs.capture.format import Capture, Known, Markers, Part, save_capture
from mphygs.capture.record import Sequence as Recording
from mphygs.synth.flower.answer import TRACK_SIGMA, answer_of
from mphygs.synth.flower.camera_rig import rest_cameras, sequence_cameras
from mphygs.synth.flower.catalogue import species
from mphygs.synth.flower.checkpoint import Checkpoint
from mphygs.synth.flower.drawing import Painter
from mphygs.synth.flower.growth import Flower, grow
from mphygs.synth.flower.hand import hand_takes
from mphygs.synth.flower.pictures import PictureView, write_pictures
from mphygs.synth.flower.pointing import write_contact, write_correspondences
from mphygs.synth.flower.progress import Progress
from mphygs.synth.flower.recording_settings import Shoot
from mphygs.synth.flower.true_motion import TrueMotion
from mphygs.synth.hidden import parse
from mphygs.synth.make import Made
from mphygs.synth.recipe import Recipe, Take, truth_spacing


def make_flower(
    name: str,
    folder: str | Path,
    *,
    hidden: Sequence[str] = (),
    seed: int = 0,
    shoot: Shoot | None = None,
    report: Callable[[float, str], None] | None = None,
) -> Made:
    """Grow a flower, move it, draw it, and write the capture, its truth and its answer.json to `folder`.

    name: of a species; hidden: each `name` or `name:key=value:...`, effects and causes; report: is called
    with the share that is done and what comes now. What an earlier call with the same arguments left there
    is kept; ValueError where the folder is of other arguments, and for names that there are not.
    SimulationError where the motion cannot be computed.
    """
    shoot = shoot or Shoot()
    flower = grow(species(name), seed)
    recipe = _recipe(flower, hidden, seed, shoot)
    made_of = {"species": name, "hidden": list(hidden), "seed": seed} | asdict(shoot)
    stored = Checkpoint.open(Path(folder), made_of)
    motion = TrueMotion(flower, recipe, recipe.hidden, _spacing(flower, shoot))
    progress = Progress(report, motion, recipe.takes, shoot, compare=bool(recipe.hidden))
    tell = progress.settling("settling under its weight")
    settled = stored.settled(lambda: motion.settle(tell))
    moved, substeps = {}, {}
    for take in recipe.takes:
        tell = progress.take(f"{take.name}: moved by the hand", take)
        moved[take.name], substeps[take.name] = stored.moved(
            take.name, lambda take=take, tell=tell: motion.run(take, settled, tell)
        )
    differences = _differences(flower, recipe, moved, shoot, stored, progress) if recipe.hidden else {}
    painter = Painter(flower, seed)
    rest_rig = rest_cameras(settled.vertices, shoot.rest_views, shoot.size)
    # Five cameras that stay where they are must see both motions.
    sweep = np.concatenate([vertices[::3].reshape(-1, 3) for vertices in moved.values()])
    rig = sequence_cameras(sweep, shoot.cameras, shoot.size)
    tracked = _tracked(flower, shoot.tracks, seed)
    rest = [PictureView(camera, None, settled.vertices) for camera in rest_rig]
    write_pictures(
        stored.folder / "rest_views", painter, rest, noise=shoot.noise, seed=seed,
        tell=progress.pictures("pictures at rest", len(rest)),
    )  # fmt: skip
    for number, take in enumerate(recipe.takes):
        views = stored.folder / "views" / take.name
        shown = [PictureView(c, frame, v) for c in rig for frame, v in enumerate(moved[take.name])]
        write_pictures(
            views, painter, shown, noise=shoot.noise, seed=seed + 1000003 * (number + 1),
            tell=progress.pictures(f"{take.name}: pictures", len(shown)),
        )  # fmt: skip
        write_contact(
            views / "contact.json", rig, motion.hold(take), take.fps, recipe.shape.pivot, seed + number
        )
        write_correspondences(
            views / "correspondences.json", painter, (rest_rig, settled.vertices),
            (rig, moved[take.name][0]), tracked, seed + number,
        )  # fmt: skip
    parts = _parts(flower, settled.vertices)
    densities = {p.name: recipe.materials[p.name].density * _volume_ratio(flower, p) for p in parts}
    _save(flower, recipe, motion, stored.folder, parts, densities, settled.vertices[tracked],
          {name: vertices[:, tracked] for name, vertices in moved.items()})  # fmt: skip
    answer = answer_of(recipe, motion, parts, densities, settled, moved, differences) | {
        "simulation": {
            "simulator": "total-lagrangian, from a stress-free shape that sags",
            "spacing": _spacing(flower, shoot),
            "blocks": motion.blocks,
            "substeps": [substeps[take.name] for take in recipe.takes],
            "speed_left_at_rest": settled.speed,
        },
        "pictures": asdict(shoot),
    }
    (stored.folder / "answer.json").write_text(
        json.dumps(answer, indent=1, allow_nan=False) + "\n", encoding="utf-8"
    )
    return Made(stored.folder, answer)


def _recipe(flower: Flower, hidden: Sequence[str], seed: int, shoot: Shoot) -> Recipe:
    shape, materials = flower.shape, flower.materials
    mass = sum(materials[part.name].density * part.volume for part in shape.parts)
    stiffest = max(m.youngs_modulus for m in materials.values())
    things = tuple(parse(text, shape, mass, stiffest) for text in hidden)
    if len({h.name for h in things}) != len(things):
        raise ValueError(f"hidden '{', '.join(hidden)}': expected every name once")
    for thing in things:
        if thing.kind == "fault":
            raise ValueError(f"hidden '{thing.name}': faults of the measurement are of captures by markers")
    takes = hand_takes(shoot.frames, seed)
    return Recipe(
        shape.name, shape, materials, takes, things, seed=seed, spacing_share=shoot.spacing_share,
        known="mass",
    )  # fmt: skip


def _spacing(flower: Flower, shoot: Shoot) -> float:
    return truth_spacing(shoot.spacing_share, flower.shape.volume)


def _tracked(flower: Flower, count: int, seed: int) -> np.ndarray:
    """(count,) vertices in random order, from every part in proportion to its share of the vertices."""
    number = [len(part.vertices) for part in flower.shape.parts]
    generator = np.random.default_rng([seed, 18])
    first = np.cumsum([0, *number[:-1]])
    least = count // (4 * len(number))
    chosen = [
        generator.choice(n, min(n, least), replace=False) + k for n, k in zip(number, first, strict=True)
    ]
    rest = np.setdiff1d(np.arange(sum(number)), np.concatenate(chosen))
    more = generator.choice(rest, count - sum(map(len, chosen)), replace=False)
    return generator.permutation(np.concatenate([*chosen, more]))


def _parts(flower: Flower, vertices: np.ndarray) -> tuple[Part, ...]:
    """The parts with their vertices moved to (V, 3), all parts one after the other."""
    ends = np.cumsum([len(part.vertices) for part in flower.shape.parts])
    pieces = np.split(vertices, ends[:-1])
    return tuple(replace(p, vertices=v) for p, v in zip(flower.shape.parts, pieces, strict=True))


def _volume_ratio(flower: Flower, part: Part) -> float:
    """Of a part before it sagged, over now: its mass is the same."""
    before = next(p for p in flower.shape.parts if p.name == part.name)
    return before.volume / part.volume


def _save(
    flower: Flower,
    recipe: Recipe,
    motion: TrueMotion,
    folder: Path,
    parts: tuple[Part, ...],
    densities: dict[str, float],
    at: np.ndarray,
    tracks: dict[str, np.ndarray],
) -> None:
    """The capture in pictures, and the one in meshes and tracks that is its truth."""

    def recording(take: Take, **measured: object) -> Recording:
        return Recording(
            take.name, take.fps, take.frames, fit=take.fit, predict=take.predict, held=(motion.hold(take),),
            **measured,
        )  # fmt: skip

    shape, ratio = recipe.shape, flower.species.poissons_ratio
    views = {take.name: folder / "views" / take.name for take in recipe.takes}
    seen = Capture(
        recipe.name, folder, shape.gravity, (), shape.rest, Known(poissons_ratio=ratio, mass=recipe.mass),
        tuple(recording(take, views=views[take.name]) for take in recipe.takes), views=folder / "rest_views",
    )  # fmt: skip
    truth = Capture(
        f"{recipe.name} truth", folder / "truth", shape.gravity, parts, shape.rest,
        Known(density=densities, poissons_ratio=ratio),
        tuple(
            recording(take, markers=Markers(tracks[take.name], at, TRACK_SIGMA)) for take in recipe.takes
        ),
    )  # fmt: skip
    save_capture(truth, folder / "truth")
    save_capture(seen, folder)


def _differences(
    flower: Flower,
    recipe: Recipe,
    moved: dict[str, np.ndarray],
    shoot: Shoot,
    stored: Checkpoint,
    progress: Progress,
) -> dict[str, dict[str, float]]:
    """How far what is hidden moves the surface: by take, over all vertices and frames [m]."""
    plain = TrueMotion(flower, recipe, (), _spacing(flower, shoot))
    tell = progress.settling("settling with nothing hidden")
    settled = stored.settled(lambda: plain.settle(tell), "plain_")
    found = {}
    for take in recipe.takes:
        tell = progress.take(f"{take.name}: with nothing hidden", take)
        other, _ = stored.moved(
            f"plain_{take.name}", lambda take=take, tell=tell: plain.run(take, settled, tell)
        )
        apart = np.linalg.norm(moved[take.name] - other, axis=2)
        found[take.name] = {
            "rms_difference_m": float(np.sqrt(np.mean(apart**2))), "largest_difference_m": float(apart.max()),
        }  # fmt: skip
    return found
