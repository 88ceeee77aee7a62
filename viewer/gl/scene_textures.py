"""A scene in textures, for OpenGL without storage buffers: splat i is texel (i % width, i // width)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import moderngl
import numpy as np

from ...scene import Gaussians, InputError
from ...scene.gaussians import SH_COEFFICIENTS
from ...scene.projection import sigmoid
from .placement import Placement, placement_of
from .scene_buffers import degree_in_use
from .texel_array import TEXTURE_WIDTH, rows_for

ROWS_AT_ONCE = 32
"""Rows converted and uploaded between two steps: a few milliseconds of work."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneTextures:
    """The attributes that projection reads, activated where exp is exact. All textures are float32."""

    splats: int
    rows: int
    placement: Placement
    sh_degree: int
    """Highest degree with a coefficient that is not zero."""
    positions: moderngl.Texture
    """xyz relative to the centre, opacity."""
    quats: moderngl.Texture
    """wxyz, raw."""
    scales: moderngl.Texture
    """Standard deviations, world units."""
    sh: moderngl.TextureArray
    """One layer a coefficient."""

    def release(self) -> None:
        for texture in (self.positions, self.quats, self.scales, self.sh):
            texture.release()


def upload_steps(ctx: moderngl.Context, gaussians: Gaussians) -> Iterator[float | SceneTextures]:
    """Uploads in slices: yields the share done (0 to 1) after each, and last the `SceneTextures`.

    Closing the generator early releases what it had made.

    Raises:
        InputError: the scene does not fit into the driver's textures or memory.
    """
    scene = _allocate(ctx, gaussians)
    done = False
    try:
        for row in range(0, scene.rows, ROWS_AT_ONCE):
            rows = min(ROWS_AT_ONCE, scene.rows - row)
            _fill(scene, gaussians, row, rows)
            yield (row + rows) / scene.rows
        done = True
        yield scene
    finally:
        if not done:
            scene.release()


def _allocate(ctx: moderngl.Context, gaussians: Gaussians) -> SceneTextures:
    n = len(gaussians)
    rows = rows_for(ctx, n, f"{n:,} splats")
    degree = degree_in_use(gaussians.sh)
    coefficients = SH_COEFFICIENTS[degree]
    size = (TEXTURE_WIDTH, rows)
    try:
        scene = SceneTextures(
            splats=n,
            rows=rows,
            placement=placement_of(gaussians.means),
            sh_degree=degree,
            positions=ctx.texture(size, 4, dtype="f4"),
            quats=ctx.texture(size, 4, dtype="f4"),
            scales=ctx.texture(size, 3, dtype="f4"),
            sh=ctx.texture_array((*size, coefficients), 3, dtype="f4"),
        )
        if ctx.error == "GL_OUT_OF_MEMORY":
            scene.release()
            raise MemoryError
    except (moderngl.Error, MemoryError) as error:
        needed = TEXTURE_WIDTH * rows * 4 * (4 + 4 + 3 + 3 * coefficients)
        raise InputError(
            f"{n:,} splats need {needed >> 20:,} MiB of graphics memory, more than there is:"
            " use --renderer cpu or fewer splats"
        ) from error
    return scene


def _fill(scene: SceneTextures, gaussians: Gaussians, row: int, rows: int) -> None:
    part = slice(row * TEXTURE_WIDTH, (row + rows) * TEXTURE_WIDTH)
    with np.errstate(over="ignore", invalid="ignore"):
        placed = np.concatenate(
            [
                gaussians.means[part] - scene.placement.centre,
                sigmoid(gaussians.opacity_logits[part])[:, None],
            ],
            axis=1,
        )
        scales = np.exp(gaussians.log_scales[part])
    viewport = (0, row, TEXTURE_WIDTH, rows)
    for texture, values in (
        (scene.positions, placed),
        (scene.quats, gaussians.quats[part]),
        (scene.scales, scales),
    ):
        texture.write(_whole_rows(values, rows), viewport=viewport)
    for layer in range(scene.sh.layers):
        values = _whole_rows(gaussians.sh[part, layer], rows)
        scene.sh.write(values, viewport=(0, row, layer, TEXTURE_WIDTH, rows, 1))


def _whole_rows(values: np.ndarray, rows: int) -> np.ndarray:
    """`values` (n, C) as contiguous float32 texels of `rows` rows, the last filled up with zeros."""
    texels = np.zeros((rows * TEXTURE_WIDTH, values.shape[1]), np.float32)
    with np.errstate(over="ignore"):
        texels[: len(values)] = values
    return texels
