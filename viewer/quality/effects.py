"""What the window knows of effects: the receipt as it stands, and their prices. No ImGui in here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from splatview.measure.effect_costs import EffectPrice
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.edits import SceneEdits
from splatview.scene.effects import Effect, settings_for
from splatview.scene.effects.appearance import background_effect
from splatview.scene.effects.census import edit_effects, lens_effect, redrawing_effect
from splatview.scene.effects.overrides import as_settings_have_them, switched
from splatview.viewer.quality.measurement import EFFECT_SECONDS, Pricing

if TYPE_CHECKING:
    from splatview.viewer.state import Core


EDITS_SHARE = 50
"""Edits are counted anew after so many times what counting took: splats under a crop that is being dragged
would be looked at in every frame."""


@dataclass(eq=False, kw_only=True)
class Effects:
    """Part of the window's `Core`; for the GL thread."""

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
    _own: tuple[Sequence[Effect], RenderSettings, list[Effect]] | None = None
    _edited: tuple[Gaussians, SceneEdits | None, list[Effect]] | None = None
    _edits_due: float = 0.0
    _cameras: tuple[Camera | None, Camera | None] = (None, None)
    """Of the frame before, and of this one."""

    def receipt(self, core: Core) -> tuple[Effect, ...]:
        """Every effect of the picture that is shown, as far as the scene has been looked through."""
        scene, found = core.scene, core.examination
        if scene is None or found is None or not found.done:
            return ()
        if self._own is None or self._own[0] is not found.effects or self._own[1] != core.settings:
            own = as_settings_have_them(found.effects, scene.gaussians, core.settings)
            self._own = found.effects, core.settings, own
        return (
            *self._own[2],
            lens_effect(core.camera),
            background_effect(core.settings),
            *self._edit_effects(core, scene.gaussians),
            redrawing_effect(core.camera, self._cameras[0]),
        )

    def _edit_effects(self, core: Core, gaussians: Gaussians) -> list[Effect]:
        """Those of the edits as they are, or as they were a moment ago where counting takes long."""
        known = self._edited
        same_scene = known is not None and known[0] is gaussians
        if known is not None and same_scene and (known[1] is core.edits or core.now() < self._edits_due):
            return known[2]
        begun = core.now()
        self._edited = gaussians, core.edits, edit_effects(gaussians, core.edits)
        ended = core.now()
        self._edits_due = ended + (ended - begun) * EDITS_SHARE
        return self._edited[2]

    def overridden(self, core: Core) -> bool:
        """Whether any effect is not as the census has it."""
        return any(effect.forced is not None for effect in self.receipt(core))

    # ---- commands

    def switch(self, core: Core, name: str, on: bool) -> None:
        """The user's word on an effect counts more than the census."""
        if core.scene is not None:
            core.settings = switched(core.scene.gaussians, core.settings, name, on)

    def as_called_for(self, core: Core) -> None:
        """Takes all switches back."""
        if core.scene is not None:
            wanted = settings_for(core.scene.gaussians)
            core.settings = replace(
                core.settings,
                model=replace(wanted.model, near=core.settings.model.near),
                sh_degree=wanted.sh_degree,
            )

    def measure(self, core: Core) -> None:
        """Begins to price the effects of the view that is seen, where that is not being done."""
        receipt = self.receipt(core)
        if self.pricing is None and receipt and core.picture is not None:
            self.pricing = Pricing(core, receipt, seconds=self.seconds, rounds=self.rounds, wake=self.wake)

    def cancel(self) -> None:
        if self.pricing is not None:
            self.pricing.cancel()

    # ---- between two frames

    @property
    def waiting(self) -> bool:
        return self.pricing is not None

    def advance(self, core: Core) -> None:
        """Takes over what was measured."""
        self._cameras = self._cameras[1], core.camera
        gaussians = core.scene.gaussians if core.scene else None
        if self._priced is not gaussians:
            self._priced, self.prices = gaussians, {}
            self.cancel()
        pricing = self.pricing
        if pricing is None or not pricing.done:
            return
        self.pricing = None
        if pricing.problem is not None:
            core.complain(pricing.problem)
        elif pricing.prices is not None and pricing.gaussians is gaussians:
            self.prices = pricing.prices
            core.tell(f"Prices of {len(self.prices)} effects measured in this view")

    def end(self) -> None:
        """The window closes."""
        if self.pricing is not None:
            self.pricing.cancel()
            self.pricing.join()
            self.pricing = None
