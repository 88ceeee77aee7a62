"""What the window knows of effects: the receipt as it stands, and their prices. No ImGui in here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from splatview.measure.effect_costs import EffectPrice
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.edits import Adjustment, SceneEdits
from splatview.scene.effects.appearance import background_effect, near_plane_effect
from splatview.scene.effects.effect import Effect
from splatview.scene.effects.overrides import as_settings_have_them, switched
from splatview.scene.effects.report import edit_effects, lens_effect, redrawing_effect, with_grade
from splatview.viewer.quality.measurement import EFFECT_SECONDS, Pricing
from splatview.viewer.state import Feature

if TYPE_CHECKING:
    from splatview.viewer.loading import Examination
    from splatview.viewer.state import AppState


EDITS_SHARE = 50
"""Edits are counted anew after so many times what counting took: splats under a crop that is being dragged
would be looked at in every frame."""


MOVING_SECONDS = 1.0
"""How long a view counts as moving after it has moved: a hand that turns it leaves frames out."""


@dataclass(eq=False, kw_only=True)
class Effects(Feature):
    """Effects of the picture that is shown, and their prices; for the GL thread."""

    wake: Callable[[], object] = lambda: None
    """Makes an idle window draw its next frame. May be called from any thread."""
    pricing: Pricing | None = None
    """Under way."""
    prices: dict[str, EffectPrice] = field(default_factory=dict)
    """By the effect's name, as last measured in this scene."""
    seconds: float = EFFECT_SECONDS
    """How long measuring may take, about."""
    rounds: int | None = None
    """So many pairs of pictures instead, however long that takes."""
    _priced: Gaussians | None = None
    _own: tuple[Examination, tuple[Adjustment, ...], RenderSettings, list[Effect]] | None = None
    _edited: tuple[Gaussians, SceneEdits | None, list[Effect]] | None = None
    _edits_due: float = 0.0
    _camera: Camera | None = None
    """Of the latest frame."""
    _before: Camera | None = None
    """The one before the view last moved, for a while; then the latest."""
    _moved: float = 0.0

    def receipt(self, app: AppState) -> tuple[Effect, ...]:
        """Every effect of the picture that is shown, as far as the scene has been looked through."""
        scene, found = app.scene, app.examination
        if found is None or not found.done:
            return ()
        palette = app.edits.palette if app.edits else ()
        shown = self._own
        if shown is None or (shown[0], shown[1]) != (found, palette) or shown[2] != app.settings:
            own = with_grade(found.effects, found.gaussians, palette)
            own = as_settings_have_them(own, scene.gaussians, app.settings)
            shown = self._own = found, palette, app.settings, own
        return (
            *shown[3],
            lens_effect(app.camera),
            near_plane_effect(scene.gaussians, app.seen_settings),
            background_effect(app.settings),
            *self._edit_effects(app, scene.gaussians),
            redrawing_effect(app.camera, self._before),
        )

    def _edit_effects(self, app: AppState, gaussians: Gaussians) -> list[Effect]:
        """Those of the edits as they are, or as they were a moment ago where counting takes long."""
        known = self._edited
        same_scene = known is not None and known[0] is gaussians
        if known is not None and same_scene and (known[1] is app.edits or app.now() < self._edits_due):
            return known[2]
        begun = app.now()
        self._edited = gaussians, app.edits, edit_effects(gaussians, app.edits)
        ended = app.now()
        self._edits_due = ended + (ended - begun) * EDITS_SHARE
        return self._edited[2]

    def overridden(self, app: AppState) -> bool:
        """Whether any effect is not as the census has it."""
        return any(effect.forced is not None for effect in self.receipt(app))

    def switch(self, app: AppState, name: str, on: bool) -> None:
        """The user's word on an effect counts more than the census."""
        if app.is_open:
            app.settings = switched(app.scene.gaussians, app.settings, name, on)

    def as_called_for(self, app: AppState) -> None:
        """Takes all switches back."""
        if app.is_open:
            wanted, near = app.called_for, app.settings.model.near
            model = replace(wanted.model, near=near)
            app.settings = replace(app.settings, model=model, sh_degree=wanted.sh_degree)

    def measure(self, app: AppState) -> None:
        """Begins to price the effects of the view that is seen, where that is not being done."""
        receipt = self.receipt(app)
        if self.pricing is None and receipt:
            self.pricing = Pricing(app, receipt, seconds=self.seconds, rounds=self.rounds, wake=self.wake)

    def cancel_measuring(self) -> None:
        if self.pricing is not None:
            self.pricing.cancel()

    def busy(self, app: AppState) -> bool:
        return self.pricing is not None

    def before_frame(self, app: AppState) -> None:
        """Takes over what was measured."""
        camera, now = app.camera, app.now()
        if self._camera is None or not camera.same_view(self._camera):
            self._before, self._camera, self._moved = self._camera, camera, now
        elif now - self._moved > MOVING_SECONDS:
            self._before = camera
        gaussians = app.scene.gaussians
        if self._priced is not gaussians:
            self._priced, self.prices = gaussians, {}
            self.cancel_measuring()
        pricing = self.pricing
        if pricing is None or not pricing.done:
            return
        self.pricing = None
        if pricing.problem is not None:
            app.complain(pricing.problem)
        elif pricing.prices is not None and pricing.gaussians is gaussians:
            self.prices = pricing.prices
            app.tell(f"Prices of {len(self.prices)} effects measured in this view")

    def close(self, app: AppState) -> None:
        if self.pricing is not None:
            self.pricing.cancel()
            self.pricing.join()
            self.pricing = None
