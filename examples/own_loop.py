"""A training loop of one's own, in plain torch over splatview's operations.

python examples/own_loop.py photos/ -o scene.ply --steps 1000
"""

import argparse

from splatview.scene.captures import load_capture
from splatview.scene.formats import save_scene
from splatview.trainer import (
    DefaultStrategy,
    MCMCStrategy,
    SelectiveAdam,
    Splats,
    TrainSettings,
    initial_parameters,
    photo_loss,
    rasterize,
    train_views,
)

STRATEGIES = {"mcmc": MCMCStrategy, "classic": DefaultStrategy}


def train(folder: str, steps: int, strategy_name: str, downscale: int) -> Splats:
    import torch

    capture = load_capture(folder, downscale=downscale)
    views, extent = train_views(capture.train), capture.extent
    settings = TrainSettings(iterations=steps, strategy=strategy_name, max_splats=50_000)

    splats = Splats(initial_parameters(capture.points, capture.point_colours, extent))
    optimizer = SelectiveAdam(splats, settings.rates(0.0, extent))
    strategy = STRATEGIES[strategy_name](settings)
    state = strategy.initialize_state(splats, extent=extent, focal=views[0].camera.fx)
    random = torch.Generator().manual_seed(0)

    for step in range(1, steps + 1):
        view = views[int(torch.randint(len(views), (), generator=random))]
        progress = (step - 1) / steps
        optimizer.rates = settings.rates(progress, extent)

        image, info = rasterize(*splats.parameters(), view.camera)
        strategy.step_pre_backward(splats, optimizer, state, step, info, progress=progress)
        loss = photo_loss(image, torch.from_numpy(view.pixels))
        loss.backward()
        optimizer.step(info.pieces)
        strategy.step_post_backward(splats, optimizer, state, step, info, progress=progress)
        optimizer.zero_grad()
        if step % 100 == 0 or step == steps:
            print(f"step {step:>6}  loss {loss.item():.4f}  {len(splats):,} splats")
    return splats


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("capture")
    parser.add_argument("-o", "--output", default="scene.ply")
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--strategy", choices=STRATEGIES, default="mcmc")
    parser.add_argument("--downscale", type=int, default=4)
    options = parser.parse_args()
    trained = train(options.capture, options.steps, options.strategy, options.downscale)
    save_scene(trained.snapshot(), options.output)
