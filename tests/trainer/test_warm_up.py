"""After warming up, training compiles nothing: a pause in the middle of a run is time that nobody planned."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

PROGRAM = """
import json, sys
from dataclasses import replace
import numpy as np
from splatview.raster import compiling
from splatview.scene import look_at
from splatview.trainer.evaluate import evaluate
from splatview.trainer.initialisation import initial_parameters
from splatview.trainer.settings import TrainSettings
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainView, TrainViews
from splatview.trainer.warm_up import BARREL, warm_up

options = json.loads(sys.argv[1])
lens, opaque, strategy = options["lens"], options["opaque"], options["strategy"]
warm_up(lens=lens, strategies=[strategy])

def known():
    return {each.py_func.__qualname__: [str(one) for one in each.signatures] for each in compiling._kernels}

before = known()
rng, views = np.random.default_rng(0), []
for number in range(6):
    eye = (2.5 * np.cos(number), 0.5, 2.5 * np.sin(number))
    camera = replace(look_at(eye, (0, 0, 0), width=40, height=32), name=f"{number}.png")
    camera = replace(camera, lens=BARREL) if lens else camera
    pixels = rng.integers(0, 255, (32, 40, 3), dtype=np.uint8)
    views.append(TrainView(camera, pixels, alpha=None if opaque else pixels[..., 0].copy()))
points = rng.uniform(-0.6, 0.6, (60, 3))
recipe = TrainSettings(
    iterations=60, max_splats=200, strategy=strategy, exposure="on", refine_from=0.0, refine_every=0.05,
    least_refine_steps=1, dropout=0.2, max_aspect=4.0, background=(0.2, 0.3, 0.4),
)
start = initial_parameters(points, np.full((60, 3), 128, np.uint8), 2.0)
trainer = Trainer(TrainViews(views[1:], 0), start, 2.0, recipe, threads=2)
trainer.nearest_depths[:] = 2.0
while not trainer.done:
    trainer.step()
evaluate(trainer.splats.arrays, views[:1], trainer.render_settings, exposures_differ=opaque)
print(json.dumps([trainer.exposures.is_on, len(trainer.splats), {
    name: found for name, found in known().items() if found != before.get(name, [])
}]))
"""


@pytest.mark.parametrize(
    "options",
    [
        {"lens": False, "opaque": True, "strategy": "mcmc"},
        {"lens": True, "opaque": False, "strategy": "mcmc"},
        {"lens": False, "opaque": False, "strategy": "classic"},
    ],
    ids=["photos", "cut out, through a lens", "cut out, classic"],
)
def test_training_compiles_nothing(options: dict[str, bool | str]) -> None:
    command = [sys.executable, "-c", PROGRAM, json.dumps(options)]
    run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=250)
    assert run.returncode == 0, run.stderr
    exposed, splats, compiled_later = json.loads(run.stdout.splitlines()[-1])
    assert exposed and splats > 60, "the run does all that others do"
    assert compiled_later == {}
