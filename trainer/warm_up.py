"""Loads or compiles every kernel that training needs, by training a toy for two steps."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import torch

from splatview.raster import Workspace
from splatview.scene import Lens, look_at
from splatview.trainer.free_space import limit_sizes
from splatview.trainer.functional import expose, shade
from splatview.trainer.initialisation import initial_parameters
from splatview.trainer.loss import mean_ssim
from splatview.trainer.settings import TrainSettings
from splatview.trainer.shading import CELLS
from splatview.trainer.strategies import STRATEGIES
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainView, TrainViews

BARREL = Lens(model="SIMPLE_RADIAL", parameters=(-0.1,))


def warm_up(*, lens: bool = False, strategies: Iterable[str] = STRATEGIES) -> None:
    """Takes about a second where kernels are cached, and a minute, once per installation, where not.

    `lens`: those for photos through a lens, rather than a pinhole; `strategies`: those of these alone.
    """
    camera = look_at((0, 0, -3), (0, 0, 0), width=16, height=16)
    view = TrainView(replace(camera, lens=BARREL if lens else None), np.zeros((16, 16, 3), np.uint8))
    points = np.random.default_rng(0).uniform(-1, 1, size=(32, 3))
    colours = np.full((32, 3), 128, np.uint8)
    for strategy in strategies:
        refined = {"refine_from": 0.0, "refine_until": 1.0, "refine_every": 0.0, "least_refine_steps": 1}
        settings = TrainSettings(iterations=2, strategy=strategy, max_splats=64, **refined)
        trainer = Trainer(TrainViews([view], 0), initial_parameters(points, colours, 1.0), 1.0, settings)
        while not trainer.done:
            trainer.step()
        # Runs do so every few steps only.
        one = [np.zeros(1, np.int32)]
        limit_sizes(trainer.splats.arrays, one, camera, settings.max_size, trainer.threads)
    mean_ssim(np.zeros((16, 16, 3), np.float32), view.pixels, Workspace())
    picture, exposure = torch.zeros(1, 1, 4, requires_grad=True), torch.zeros(3, 2, dtype=torch.float64)
    shaded = shade(picture, torch.zeros(CELLS, CELLS, dtype=torch.float64, requires_grad=True))
    expose(shaded, exposure.requires_grad_()).sum().backward()
