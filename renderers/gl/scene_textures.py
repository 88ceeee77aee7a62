"""A scene in textures, for OpenGL without storage buffers: splat i is texel (i % width, i // width)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import moderngl
import numpy as np

from splatview.renderers.gl.context import COMPONENT_BYTES, check_room, no_room
from splatview.renderers.gl.scene_buffers import (
    DEGREE_BITS,
    Placement,
    StoredHarmonics,
    upload_plan,
)
from splatview.scene import Gaussians, InputError
from splatview.scene.gaussians import SH_COEFFICIENTS
from splatview.scene.projection import sigmoid

TEXTURE_WIDTH = 2048
"""Texels a row: every driver of the last fifteen years has wider textures, and 16384 rows hold 33 million."""


def rows_for(ctx: moderngl.Context, texels: int, what: str) -> int:
    """Rows of TEXTURE_WIDTH that hold `texels`; `what` they are is said in the error.

    Raises:
        InputError: more than this driver's textures have.
    """
    rows, limit = -(-max(texels, 1) // TEXTURE_WIDTH), int(ctx.info["GL_MAX_TEXTURE_SIZE"])
    if not rows <= limit:
        raise InputError(
            f"{what} do not fit into this OpenGL driver's textures"
            f" ({limit * TEXTURE_WIDTH:,} do): use --renderer cpu or fewer splats"
        )
    return rows


class TexelArray:
    """Element i is texel (i % TEXTURE_WIDTH, i // TEXTURE_WIDTH); see ``common/texels.glsl``."""

    def __init__(self, ctx: moderngl.Context, components: int, dtype: str, what: str) -> None:
        self._ctx = ctx
        self._components = components
        self._dtype = dtype
        self._what = what
        self._rows = 0
        self._texture: moderngl.Texture | None = None

    @property
    def texture(self) -> moderngl.Texture:
        """Exists after `reserve`."""
        if self._texture is None:
            raise RuntimeError("reserve() comes first")
        return self._texture

    def reserve(self, texels: int) -> None:
        """Makes room for at least so many; where there was less before, the contents are lost.

        Raises:
            InputError: they are more than this driver's textures have, or than there is memory for.
        """
        rows = rows_for(self._ctx, texels, f"{texels:,} {self._what}")
        if rows <= self._rows:
            return
        self.release()
        size = TEXTURE_WIDTH * rows * self._components * COMPONENT_BYTES[self._dtype]
        what = f"{texels:,} {self._what}"
        try:
            self._texture = self._ctx.texture((TEXTURE_WIDTH, rows), self._components, dtype=self._dtype)
            check_room(self._ctx, what, size)
        except moderngl.Error as error:
            raise no_room(what, size) from error
        except InputError:
            self.release()
            raise
        self._rows = rows

    def write(self, values: np.ndarray, first: int = 0) -> None:
        """Writes `values`, (n,) or (n, components) of the texture's dtype, to elements from `first` on."""
        values = np.ascontiguousarray(values)
        at, end = first, first + len(values)
        while at < end:
            row, column = divmod(at, TEXTURE_WIDTH)
            rows = (end - at) // TEXTURE_WIDTH if column == 0 else 0
            # Whole rows at once, and what is left of a row before and after them.
            width = TEXTURE_WIDTH if rows else min(TEXTURE_WIDTH - column, end - at)
            size = width * max(rows, 1)
            part = values[at - first : at - first + size]
            self.texture.write(part, viewport=(column, row, width, max(rows, 1)))
            at += size

    def release(self) -> None:
        if self._texture is not None:
            self._texture.release()
        self._texture, self._rows = None, 0


ROWS_AT_ONCE = 32
"""Rows converted and uploaded between two steps: a few milliseconds of work."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneTextures:
    """The attributes that projection reads, activated where exp is exact. All textures are float32."""

    splats: int
    rows: int
    placement: Placement
    harmonics: StoredHarmonics
    positions: moderngl.Texture
    """xyz relative to the centre, opacity."""
    quats: moderngl.Texture
    """wxyz, raw."""
    scales: moderngl.Texture
    """Standard deviations, world units."""
    sh: moderngl.TextureArray
    """One layer a coefficient. Where splats have their own degrees, all coefficients one after the other, row
    by row and layer by layer."""
    rests: moderngl.Texture | None
    """What float32 leaves over of the positions, where the scene is wide."""
    places: moderngl.Texture | None
    """uint32, where splats have their own degrees: see `harmonics.places`, counted in coefficients."""

    @property
    def sh_degree(self) -> int:
        """The highest that is uploaded."""
        return self.harmonics.sh_degree

    @property
    def sh_layer(self) -> int:
        """Texels of one layer."""
        return TEXTURE_WIDTH * self.rows

    def flags(self) -> dict[str, float | bool]:
        """Of ``quads_gl33/project.frag.glsl``."""
        return {"OWN_DEGREES": self.places is not None, "WIDE": self.rests is not None}

    def release(self) -> None:
        for texture in (*(self.positions, self.quats, self.scales, self.sh), *(self.places, self.rests)):
            if texture is not None:
                texture.release()


def upload_steps(
    ctx: moderngl.Context, gaussians: Gaussians, *, every_band: bool = False
) -> Iterator[float | SceneTextures]:
    """Uploads in slices: yields the share done (0 to 1) after each, and last the `SceneTextures`.

    Closing the generator early releases what it had made. `every_band`: see `stored_harmonics`.

    Raises:
        InputError: the scene does not fit into the driver's textures or memory.
    """
    scene = _allocate(ctx, gaussians, upload_plan(gaussians, every_band=every_band).harmonics)
    coefficients = 0
    done = False
    try:
        for row in range(0, scene.rows, ROWS_AT_ONCE):
            rows = min(ROWS_AT_ONCE, scene.rows - row)
            _fill(scene, gaussians, row, rows)
            coefficients += _fill_harmonics(scene, gaussians, row, rows, coefficients)
            yield (row + rows) / scene.rows
        done = True
        yield scene
    finally:
        if not done:
            scene.release()


def _allocate(ctx: moderngl.Context, gaussians: Gaussians, harmonics: StoredHarmonics) -> SceneTextures:
    n = len(gaussians)
    rows = rows_for(ctx, n, f"{n:,} splats")
    size = (TEXTURE_WIDTH, rows)
    layers, own = SH_COEFFICIENTS[harmonics.sh_degree], harmonics.own_degrees
    if own is not None:
        layers = -(-int(np.array(SH_COEFFICIENTS)[own].sum()) // (TEXTURE_WIDTH * rows))
    placement = upload_plan(gaussians).placement
    try:
        scene = SceneTextures(
            splats=n,
            rows=rows,
            placement=placement,
            harmonics=harmonics,
            positions=ctx.texture(size, 4, dtype="f4"),
            quats=ctx.texture(size, 4, dtype="f4"),
            scales=ctx.texture(size, 3, dtype="f4"),
            sh=ctx.texture_array((*size, layers), 3, dtype="f4"),
            rests=ctx.texture(size, 3, dtype="f4") if placement.wide else None,
            places=None if own is None else ctx.texture(size, 1, dtype="u4"),
        )
        if ctx.error == "GL_OUT_OF_MEMORY":
            scene.release()
            raise MemoryError
    except (moderngl.Error, MemoryError) as error:
        needed = TEXTURE_WIDTH * rows * 4 * (4 + 4 + 3 + 3 * layers)
        raise InputError(
            f"{n:,} splats need {needed >> 20:,} MiB of graphics memory, more than there is:"
            " use --renderer cpu or fewer splats"
        ) from error
    return scene


def _fill(scene: SceneTextures, gaussians: Gaussians, row: int, rows: int) -> None:
    part = slice(row * TEXTURE_WIDTH, (row + rows) * TEXTURE_WIDTH)
    high, rest = scene.placement.split(gaussians.means[part])
    with np.errstate(over="ignore", invalid="ignore"):
        placed = np.concatenate([high, sigmoid(gaussians.opacity_logits[part])[:, None]], axis=1)
        scales = np.exp(gaussians.log_scales[part])
    viewport = (0, row, TEXTURE_WIDTH, rows)
    for texture, values in (
        (scene.positions, placed),
        (scene.quats, gaussians.quats[part]),
        (scene.scales, scales),
    ):
        texture.write(_whole_rows(values, rows), viewport=viewport)
    if scene.rests is not None:
        scene.rests.write(_whole_rows(rest, rows), viewport=viewport)


def _fill_harmonics(scene: SceneTextures, gaussians: Gaussians, row: int, rows: int, first: int) -> int:
    """Writes those of some rows of splats, which, where splats have their own degrees, begin with coefficient
    `first`; returns how many they are."""
    part = slice(row * TEXTURE_WIDTH, min((row + rows) * TEXTURE_WIDTH, scene.splats))
    if scene.places is None:
        for layer in range(scene.sh.layers):
            values = _whole_rows(gaussians.sh[part, layer], rows)
            scene.sh.write(values, viewport=(0, row, layer, TEXTURE_WIDTH, rows, 1))
        return 0
    degrees = scene.harmonics.of(part)
    counts = np.array(SH_COEFFICIENTS)[degrees]
    starts = (first + np.cumsum(counts) - counts).astype(np.uint32)
    own = np.zeros(rows * TEXTURE_WIDTH, np.uint32)
    own[: len(degrees)] = starts << DEGREE_BITS | degrees
    scene.places.write(own, viewport=(0, row, TEXTURE_WIDTH, rows))
    coefficients = SH_COEFFICIENTS[scene.sh_degree]
    values = gaussians.sh[part, :coefficients][np.arange(coefficients) < counts[:, None]]
    at = 0
    while at < len(values):
        # Runs within a row, whole rows where there are any.
        line, column = divmod(first + at, TEXTURE_WIDTH)
        layer, line = divmod(line, scene.rows)
        whole = min((len(values) - at) // TEXTURE_WIDTH, scene.rows - line) if column == 0 else 0
        width = TEXTURE_WIDTH if whole else min(TEXTURE_WIDTH - column, len(values) - at)
        size = width * max(whole, 1)
        run = np.ascontiguousarray(values[at : at + size])
        scene.sh.write(run, viewport=(column, line, layer, width, max(whole, 1), 1))
        at += size
    return len(values)


def _whole_rows(values: np.ndarray, rows: int) -> np.ndarray:
    """`values` (n, C) as contiguous float32 texels of `rows` rows, the last filled up with zeros."""
    texels = np.zeros((rows * TEXTURE_WIDTH, values.shape[1]), np.float32)
    with np.errstate(over="ignore"):
        texels[: len(values)] = values
    return texels
