"""Programs of a window: general ones stand in until the specialised ones have been compiled elsewhere."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator

import moderngl

from splatview.renderers.gl.context import describe
from splatview.renderers.gl.programs import Made, Variant, Variants, expand
from splatview.renderers.modes import MODES, VisualMode
from splatview.renderers.precompile import SIZE, ShaderPrecompiler, few_splats, precompile_job
from splatview.renderers.request import FrameRequest, Renderer
from splatview.scene.framing import frame_camera

STALL = 0.05
"""Seconds that a program may take here which has been compiled elsewhere: three late frames. More, and the
driver has kept nothing."""

TITLES = {
    "HIDES": "hidden splats",
    "ADJUSTS": "adjusted splats",
    "CROPS": "crops",
    "TINTS": "marked splats",
    "ANTIALIASED": "antialiasing",
    "LENS": "a lens",
    "ORTHOGRAPHIC": "parallel rays",
    **{mode.flag: mode.name for mode in MODES.values() if mode.flag is not None},
    "WEIGHTED": "weighted order",
    "STOCHASTIC": "stochastic order",
    "DISCS": "discs",
    "GRADIENT": "a gradient behind",
    "PANORAMA": "a panorama behind",
    "BEHIND": "a picture behind",
}
"""What the user is told of flags that are on."""


class FallbackShaders(Variants):
    """Compiles a specialised program here only once it has been compiled in the background, so that it
    comes out of the driver's cache, which takes a moment."""

    def __init__(self, ctx: moderngl.Context, precompiler: ShaderPrecompiler) -> None:
        super().__init__(ctx, waits_for=self._has_to_wait)
        self._precompiler = precompiler
        info = describe(ctx)
        self._driver = f"{info.renderer} {info.version}"
        self._keys: dict[Variant, str] = {}
        self._put_off: set[Variant] = set()
        self.driver_remembers = True
        """Whether what has been compiled in the background is quickly had here. Where not, specialised
        programs are compiled while a scene is loaded, and general ones do until then."""

    def prepare(self, renderer: Renderer) -> None:
        """Compiles the general programs, by drawing a few splats; that scene is the renderer's then."""
        sample = few_splats()
        # Each has programs or targets that the others have not.
        distinct: dict[tuple[bool, bool], VisualMode] = {
            (mode.surfaces, mode.sums): mode.name for mode in reversed(tuple(MODES.values()))
        }
        with self.generally():
            for mode in distinct.values():
                renderer.draw(FrameRequest(sample, frame_camera(sample, *SIZE), mode=mode))

    def after_drawing(self, backend: str, request: FrameRequest) -> None:
        """Has compiled what general programs have just stood in for; `request` names its scene."""
        waiting = self.take_waiting()
        if not waiting or request.gaussians is None or not len(request.gaussians):
            return
        if not self.driver_remembers:
            self._put_off |= waiting
            return
        self._precompiler.ask(
            [self._key(variant) for variant in waiting],
            title_of(waiting),
            lambda: precompile_job(
                backend, request, variants=waiting, gl_version=self._precompiler.gl_version
            ),
        )

    def while_loading(self) -> Iterator[None]:
        """Compiles what was put off until a scene is loaded, one by one."""
        while self._put_off:
            self._compiled(self._put_off.pop())
            yield

    def _has_to_wait(self, variant: Variant) -> bool:
        return not self.driver_remembers or not self._precompiler.is_done([self._key(variant)])

    def _compiled(self, variant: Variant) -> Made:
        if variant in self._made:
            return self._made[variant]
        precompiled = not variant.general and self._precompiler.is_done([self._key(variant)])
        begun = time.perf_counter()
        made = super()._compiled(variant)
        if precompiled and time.perf_counter() - begun > STALL:
            self.driver_remembers = False
        return made

    def _key(self, variant: Variant) -> str:
        """The same for what a driver would find in its cache."""
        if variant not in self._keys:
            flags = dict(variant.flags)
            sources = [expand(file, "430 core", flags, general=variant.general)[0] for file in variant.files]
            digest = hashlib.sha256("\0".join((self._driver, *sources)).encode())
            self._keys[variant] = f"gl {digest.hexdigest()[:32]}"
        return self._keys[variant]


def title_of(variants: frozenset[Variant]) -> str:
    """The effects of which these are the programs: "hidden splats, crops"."""
    on = {flag for variant in variants for flag, value in variant.flags if value is True}
    titles = [title for flag, title in TITLES.items() if flag in on]
    return ", ".join(titles) or "what this scene calls for"
