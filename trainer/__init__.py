"""Training splats from photos. The loop itself is numpy and the rasteriser; torch is for loops of one's own.

`training.Trainer` takes steps, `training_run.TrainingRun` takes it through a run, `thread.BackgroundTraining` does so
beside a window; `render` and `torch_loss` are the
differentiable picture and the photo loss as torch operations.
"""
