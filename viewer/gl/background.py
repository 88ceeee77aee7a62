"""Backgrounds as the shaders take them: uniforms, and a texture only where one is a picture."""

from __future__ import annotations

import moderngl
import numpy as np

from ...scene import Camera, InputError
from ...scene.background import Background, Gradient, Panorama, axes_of, pixel_rays, seen
from .view_uniforms import Uniform

UNIT = 2
"""The texture unit of `u_behind`."""


class BackgroundSource:
    """Keeps the texture of the latest picture; one colour or a gradient has none."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._texture: moderngl.Texture | None = None
        self._shown: object = None

    def use(self, background: Background, camera: Camera) -> tuple[dict[str, bool], dict[str, Uniform]]:
        """Flags and uniforms of ``common/background.glsl`` for what `camera` sees; binds the texture.

        Raises:
            InputError: a panorama is larger than textures can be here.
        """
        flags = {"GRADIENT": False, "PANORAMA": False, "BEHIND": False}
        if isinstance(background, tuple):
            self.release()
            return flags, {"u_background": background}
        rays = pixel_rays(camera)
        if rays is None:
            self._show_picture(background, camera)
            return flags | {"BEHIND": True}, {"u_behind": UNIT}
        # moderngl takes matrices column by column.
        values: dict[str, Uniform] = {"u_background_rays": tuple((axes_of(background) @ rays).T.ravel())}
        if isinstance(background, Gradient):
            self.release()
            values |= {"u_background": background.bottom, "u_top": background.top}
            return flags | {"GRADIENT": True}, values
        self._show_panorama(background)
        return flags | {"PANORAMA": True}, values | {"u_behind": UNIT}

    def _show_panorama(self, panorama: Panorama) -> None:
        if self._shown is not panorama.pixels:
            height, width = panorama.pixels.shape[:2]
            largest = int(self._ctx.info["GL_MAX_TEXTURE_SIZE"])
            if not max(width, height) <= largest:
                raise InputError(
                    f"{panorama.name}: is {width}x{height} pixels, and OpenGL holds {largest} a side here; "
                    "use a smaller picture"
                )
            self._replace(self._ctx.texture((width, height), 3, panorama.pixels.tobytes(), alignment=1))
            self._shown = panorama.pixels  # by another up axis it is the same texture
        self._bind()

    def _show_picture(self, background: Background, camera: Camera) -> None:
        kept = self._shown
        if not (isinstance(kept, tuple) and kept[0] is background and camera.same_view(kept[1])):
            data = np.ascontiguousarray(seen(background, camera, np.float32)).tobytes()
            self._replace(self._ctx.texture((camera.width, camera.height), 3, data, dtype="f4"))
            self._shown = background, camera
        self._bind()

    def _replace(self, texture: moderngl.Texture) -> None:
        self.release()
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._texture = texture

    def _bind(self) -> None:
        if self._texture is not None:
            self._texture.use(UNIT)

    def release(self) -> None:
        """Gives the texture back."""
        if self._texture is not None:
            self._texture.release()
        self._texture, self._shown = None, None
