"""Training splats from photos. The loop itself is numpy and the rasteriser; torch is for loops of one's own.

`trainer.Trainer` takes steps, `run.TrainingRun` takes it through a run, `background.BackgroundTraining`
does so beside a window; `torch_api` has the differentiable picture and the photo loss as torch operations.
"""
