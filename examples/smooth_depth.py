"""A loss of one's own: depth is smooth where the photo is (Godard et al. 2017, Monodepth).

    splatview train photos/ --plugin examples/smooth_depth.py

Neighbouring pixels of one colour are drawn to one depth; where the photo has an edge, depth may have one.
"""

WEIGHT = 0.01


def slopes(values):
    """Differences of neighbours, of columns and of rows."""
    return values[:, 1:] - values[:, :-1], values[1:] - values[:-1]


def loss(step):
    # Every 4th step: depth costs another picture.
    if step.iteration % 4:
        return step.photo_loss
    depth = step.depth()
    depth = depth / depth.detach().mean().clamp_min(1e-6)
    photo = step.photo.float() / 255
    smoothness = 0.0
    for of_depth, of_photo in zip(slopes(depth), slopes(photo), strict=True):
        smoothness = smoothness + (of_depth.abs() * (-5 * of_photo.abs().mean(dim=2)).exp()).mean()
    return step.photo_loss + WEIGHT * smoothness
