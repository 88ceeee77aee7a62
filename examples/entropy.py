"""A loss of one's own: splats are drawn to be either opaque or gone, which leaves less haze.

    splatview train photos/ --plugin examples/entropy.py

The entropy of an opacity is greatest at one half and 0 at 0 and 1.
"""

WEIGHT = 0.01


def loss(step):
    opacity = step.splats.opacity_logits.sigmoid().clamp(1e-6, 1 - 1e-6)
    entropy = -(opacity * opacity.log() + (1 - opacity) * (1 - opacity).log()).mean()
    # Once the scene has taken shape: at the start nothing is sure yet.
    return step.photo_loss + WEIGHT * step.progress * entropy
