"""A baseline that sees pictures and nothing else: a field of E, and of the velocity at the start."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from command_example import answer
from mphygs.baselines import field, targets, triplane
from mphygs.baselines.kinds import maker_of
from mphygs.commands import fit
from mphygs.fit import image_fit
from mphygs.fit.image_fit import Watched
from mphygs.fit.of_run import experiment_of, pictured_of
from mphygs.fit.pictured import Pictured
from mphygs.fit.run import load_run
from mphygs.fit.start import starting_belief
from mphygs.render.splatting import splat
from pictured_example import pictured_flower, stages_of_truth


def stiff_stem(box: np.ndarray) -> dict[str, np.ndarray]:
    """A field that falls along the stem, by a factor of ten or so, and a frog that moves when it is first
    seen, along y."""
    values = {name: np.zeros(shape) for name, shape in field.STIFFNESS.items()}
    values["planes"][1, 0] = np.linspace(1.0, -1.0, triplane.RESOLUTION)[:, None]
    values["weight0"][0, triplane.CHANNELS], values["bias0"][0], values["weight1"][0, 0] = 1.0, 1.0, 1.2
    values["level"][0] = 0.0
    velocity = {name: np.zeros(shape) for name, shape in field.VELOCITY.items()}
    velocity["bias0"][0], velocity["weight1"][1, 0] = 1.0, 3.0
    return values | {"box": box} | {f"velocity.frog.{name}": value for name, value in velocity.items()}


def shown_by(values: Mapping[str, np.ndarray]) -> Callable[..., Watched]:
    """In the place of `watch`: some frames as two cameras see the object that a field moves."""

    def watch(pictured: Pictured, name: str, span: tuple[int, int], *, looks: bool) -> Watched:
        seen = image_fit.watch(pictured, name, span, looks=looks)
        one = pictured.predictor(name)
        mover = field.FieldPredictor(values, one.capture, one.recording, one.settings, body=one.body)
        belief = starting_belief(pictured.experiment.capture, prestress="paper")
        position = mover.predict(belief, last=span[1]).position
        pictures = {}
        for frame in range(1, span[1], 2):
            place = torch.from_numpy(pictured.placement(name).to_world(position[frame]))
            gaussians, views = pictured.coloured(place), seen.pictures[frame][:2]
            pictures[frame] = [replace(v, colour=splat(gaussians, v.camera).colour) for v in views]
        return replace(seen, pictures=pictures)

    return watch


@pytest.mark.slow
def test_a_field_fits_the_pictures_that_one_makes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stages_of_truth(pictured_flower(tmp_path / "daisy"), tmp_path / "stages")
    truth = stiff_stem(np.zeros((2, 3)))

    def shown(pictured: Pictured, *arguments: object, **options: object) -> Watched:
        truth["box"] = np.asarray(pictured.experiment.capture.bounds)
        return shown_by(truth)(pictured, *arguments, **options)

    monkeypatch.setattr(targets, "watch", shown)
    options = ("--spacing", 0.009, "--workers", 1, "--prestress", "paper", "--stages", tmp_path / "stages")
    answer(fit.main, tmp_path / "daisy", "--baseline", "field", "--out", tmp_path / "run", *options)
    run = load_run(tmp_path / "run")
    costs = [cost for record in run.history for cost in record.costs]
    assert costs[-1] < 0.1 * costs[0]
    make = maker_of(run)
    experiment, belief = experiment_of(run, workers=1, make=make)
    pictured = pictured_of(run, experiment)
    # of the frames fitted, and with those after, against the best that is as stiff everywhere and at rest
    one, alike = pictured.predictor("frog"), field.starting_weights(0) | {"box": truth["box"]}
    for last, share in ((12, 0.5), (24, 0.7)):

        def moved(values: Mapping[str, np.ndarray], last: int = last) -> np.ndarray:
            other = field.FieldPredictor(values, one.capture, one.recording, one.settings, body=one.body)
            return other.predict(belief, last=last).position

        levels = np.arange(0.0, 2.1, 0.5)
        others = [moved(alike | {"level": np.array([level])}) for level in levels]
        positions = (one.predict(belief, last=last).position, *others)
        found, *rest = [float(((position - moved(truth)) ** 2).mean()) ** 0.5 for position in positions]
        assert found < share * min(rest)
    assert pictured.predictor("turned").velocity is None and one.velocity is not None
