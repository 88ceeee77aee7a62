"""Training splats from photos, in torch over the kernels of the CPU rasteriser.

`trainer.Trainer` is the loop, `run.TrainingRun` takes it through a run, `background.BackgroundTraining` does
so beside a window. The names below are for loops and losses of one's own; torch is imported when the first of
them is asked for, and modules that only read settings, captures and checkpoints do without it.
"""

from __future__ import annotations

import importlib
from typing import Any

NAMES = {
    "train": "setup",
    "TrainedScene": "setup",
    "Trainer": "trainer",
    "TrainSettings": "settings",
    "Splats": "splats",
    "SelectiveAdam": "adam",
    "Rates": "adam_kernels",
    "rasterize": "functional",
    "rasterize_depth": "functional",
    "photo_loss": "functional",
    "Visibility": "functional",
    "LossStep": "plugin",
    "PluginError": "counters",
    "DefaultStrategy": "strategies.default",
    "DefaultSettings": "strategies.default",
    "MCMCStrategy": "strategies.mcmc",
    "MCMCSettings": "strategies.mcmc",
    "initial_parameters": "initialisation",
    "evaluate": "evaluate",
    "train_views": "views",
}
"""Public name -> the module of this package that has it."""


def __getattr__(name: str) -> Any:
    if name not in NAMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    importlib.import_module(f"{__name__}.torch_import").require_torch()
    return getattr(importlib.import_module(f"{__name__}.{NAMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *NAMES})
