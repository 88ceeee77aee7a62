"""What effects cost or save in time, on this machine, in this view: each turned the other way, by the
ladder's machinery."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from splatview.measure.knobs import Plan
from splatview.measure.ladder import (
    LEAST_PAIRS,
    Measured,
    Rung,
    SceneRenderer,
    draw_by_path,
    is_clear,
    run_ladder,
    timed_draw,
)
from splatview.scene import Camera, Gaussians
from splatview.scene.effects.effect import Effect
from splatview.scene.effects.overrides import in_force, switched

EDITS = "edits in force"
"""Not an effect of the census: its are told apart by kind, but pictures have all edits or none."""

FRAMES_A_RUNG = 2 + 2 * LEAST_PAIRS
"""At least: two that are looked at, and pairs with the baseline."""


@dataclass(frozen=True, kw_only=True)
class EffectPrice:
    """One effect, and the picture with it the other way."""

    name: str
    on: bool
    """In the picture as it is drawn."""
    ms: float
    """Of a frame as it is drawn."""
    saved_ms: float
    """What a frame without the effect takes less than one with it, whichever is drawn; below 0 where it is
    faster with it."""
    noise_ms: float
    """How far `saved_ms` may be off by chance."""
    clear: bool
    """Whether a difference may be claimed at all."""
    psnr: float
    """dB, of the picture with the effect the other way against the one drawn; inf where they are equal."""
    max_error: float
    """Largest difference of any pixel and colour between the two."""

    def __str__(self) -> str:
        word = ("costs" if self.saved_ms > 0 else "saves") if self.on else "would cost"
        if not self.on and self.saved_ms <= 0:
            word = "would save"
        time = f"{word} {abs(self.saved_ms):.2g} ms of {self.ms:.3g}"
        if not self.clear:
            time = f"no difference in time beyond {self.noise_ms:.2g} ms"
        change = f"{'without it' if self.on else 'with it'} a pixel changes by up to {self.max_error:.2g}"
        return f"{time}; {change if self.max_error > 0 else 'the same picture either way'}"


def price_effects(
    renderer: SceneRenderer,
    plan: Plan,
    gaussians: Gaussians,
    effects: Sequence[Effect],
    camera: Camera,
    *,
    moved: Callable[[int, int], Camera],
    seconds: float,
    rounds: int | None = None,
    unedited: SceneRenderer | None = None,
    on_progress: Callable[[float, str], None] = lambda share, text: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> dict[str, EffectPrice] | None:
    """By name, the price of each of `effects` that settings can turn the other way; None where cancelled.

    `renderer` draws by `plan`; `moved`, `seconds`, `rounds` as for `run_ladder`. `unedited` draws the scene
    without its edits, whose price is then told as EDITS. Where `seconds` are too few for all, each still gets
    LEAST_PAIRS.
    """
    settings = plan.settings
    now = in_force(gaussians, settings)
    base = Rung(knob="renderer", value=renderer.name, renderer=renderer, plan=plan, options=())
    rungs = [base]
    for effect in effects:
        if effect.can_override and effect.name in now:
            other = replace(plan, settings=switched(gaussians, settings, effect.name, not now[effect.name]))
            if other != plan:
                rungs.append(_rung(effect.name, renderer, other))
    if unedited is not None:
        rungs.append(_rung(EDITS, unedited, plan))
    renderer.prepare(plan)
    picture, _ = draw_by_path(renderer, camera, plan)
    # The second has no memory to take and nothing to compile.
    frame = 1e-3 * timed_draw(base, moved(0, 0))
    if rounds is None and FRAMES_A_RUNG * len(rungs) * frame > seconds:
        rounds = LEAST_PAIRS
    ladder = run_ladder(
        rungs,
        [camera],
        [picture],
        moved=moved,
        seconds=seconds,
        rounds=rounds,
        on_progress=on_progress,
        cancelled=cancelled,
    )
    if not ladder.complete:
        return None
    ms = ladder.baseline.ms
    return {
        one.rung.value: _price(one, ms, now.get(one.rung.value, True))
        for one in ladder.rungs
        if one.rung is not base and math.isfinite(one.ratio)
    }


def _rung(name: str, renderer: SceneRenderer, plan: Plan) -> Rung:
    return Rung(knob="effect", value=name, renderer=renderer, plan=plan, options=(), rank=1)


def _price(other: Measured, ms: float, on: bool) -> EffectPrice:
    difference = ms * (1 - other.ratio)
    return EffectPrice(
        name=other.rung.value,
        on=on,
        ms=ms,
        saved_ms=difference if on else -difference,
        noise_ms=ms * other.noise,
        clear=is_clear(other),
        psnr=other.psnr,
        max_error=other.max_error,
    )
