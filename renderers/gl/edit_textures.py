"""The edits in force, where shaders can read them: uploaded where they changed, absent if there are none."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import moderngl
import numpy as np

from splatview.renderers.depth_colours import sample_step
from splatview.renderers.gl.scene_buffers import Placement, placement_of
from splatview.renderers.gl.scene_textures import TEXTURE_WIDTH, TexelArray
from splatview.renderers.gl.uniforms import set_uniforms
from splatview.renderers.modes import MODES, VisualMode
from splatview.renderers.request import TINT_COUNT, Highlight
from splatview.scene.edits import (
    CROP_ROW,
    FILE_LOCKED,
    LOCKED,
    NOT_SHOWN,
    PALETTE_SHIFT,
    PREVIEW,
    ROW,
    SELECTED,
    Adjustment,
    Crop,
    SceneEdits,
    adjusted_points,
    adjustment_rows,
    crop_rows,
)

FIRST_UNIT = 8
"""Texture units from here on are the edits'; drawing uses those before."""

SLICE = 65_536
"""Marks compared at once, so that they stay in the caches."""

ONLY_LIT_UP = SELECTED | LOCKED | PREVIEW
"""Flags that change nothing but tints."""


@dataclass(frozen=True, kw_only=True)
class Editing:
    """What of the edits a picture depends on; equal ones give equal pictures of the same scene."""

    hides: bool = False
    palette: tuple[Adjustment, ...] | None = None
    """None: no splat has an adjustment."""
    crops: tuple[Crop, ...] = ()
    marks: int = 0
    """How often marks have changed what is shown, where that counts."""
    highlight: Highlight | None = None
    """None: no splat is lit up."""
    lit: int = 0
    """How often marks have changed what is lit up, where that counts."""

    @cached_property
    def footprints(self) -> tuple:
        """Equal ones give equal projections."""
        return (self.hides, self.palette, self.crops, self.marks)

    def tints_of(self, mode: VisualMode) -> tuple | None:
        """Equal ones light up alike; None: nothing in this mode."""
        return None if self.highlight is None or not MODES[mode].tintable else (self.highlight, self.lit)

    @property
    def places(self) -> tuple | None:
        """Equal ones put means at the same places; None: where the scene has them."""
        if self.palette is None or not any(adjustment.moves for adjustment in self.palette):
            return None
        return (self.palette, self.marks)

    def flags(self, *, projects: bool = True, shows: VisualMode | None = None) -> dict[str, float | bool]:
        """Flags for what includes ``common/edits.glsl`` (`projects`) or ``common/tint.glsl`` (`shows`)."""
        return {
            "HIDES": projects and self.hides,
            "ADJUSTS": projects and self.palette is not None,
            "CROPS": projects and bool(self.crops),
            "TINTS": shows is not None and self.tints_of(shows) is not None,
            "TEXTURE_WIDTH": TEXTURE_WIDTH,
            "PALETTE_SHIFT": PALETTE_SHIFT,
            "NOT_SHOWN": NOT_SHOWN,
            "FILE_LOCKED": FILE_LOCKED,
            "ROW_TEXELS": ROW // 4,
            "CROP_TEXELS": CROP_ROW // 4,
            "TINT_COUNT": TINT_COUNT,
        }


NOT_EDITED = Editing()


class EditTextures:
    """Marks, palette and crops of the scene that is loaded.

    What marks held is kept here too (4 bytes per splat), to tell a new selection, which is only lit up,
    from a change of what is shown.
    """

    def __init__(self, ctx: moderngl.Context) -> None:
        self._marks = TexelArray(ctx, 1, "u4", "marks")
        self._palette = TexelArray(ctx, 4, "f4", "numbers of adjustments, in fours,")
        self._crops = TexelArray(ctx, 4, "f4", "numbers of crops, in fours,")
        self.marks_uploaded = 0
        """How many marks have been sent to the GPU so far."""
        self.load(placement_of(np.zeros((0, 3))), np.zeros((0, 3)))

    def load(self, placement: Placement, means: np.ndarray) -> None:
        """Forgets all edits: another scene is loaded, with splats at `means` (N, 3)."""
        self.release()
        self._unedited, self._means = placement, means
        self._moved: tuple[object, Placement] | None = None
        self._source: np.ndarray | None = None
        self._held = np.zeros(0, np.uint32)
        self._version = 0
        self._shown_changes = self._lit_changes = 0
        self._held_palette: tuple[Adjustment, ...] | None = None
        self._held_crops: tuple[Crop, ...] = ()
        self.now = NOT_EDITED

    def update(self, edits: SceneEdits | None, highlight: Highlight | None) -> Editing:
        """Brings the textures up to date with `edits` of the scene; no `highlight`: no tints.

        Raises:
            ValueError: there are not as many marks as splats.
            InputError: they do not fit into the driver's textures.
        """
        if edits is None:
            self.now = NOT_EDITED
            return self.now
        splats = len(self._means)
        if len(edits.marks) != splats:
            raise ValueError(f"{len(edits.marks):,} marks for a scene of {splats:,} splats")
        transmittance = highlight is not None and highlight.applies_to(edits)
        matters = edits.hides or edits.adjusts
        if matters or transmittance:
            self._update_marks(edits)
        if edits.adjusts and edits.palette != self._held_palette:
            rows = adjustment_rows(edits.palette, self._unedited.centre)
            # What float32 drops of the translation goes into the row's free columns.
            rows[:, 33:36] = rows[:, 3:12:4] - rows[:, 3:12:4].astype(np.float32)
            _fill(self._palette, rows)
            self._held_palette = edits.palette
        crops = edits.crops_in_force
        if crops and crops != self._held_crops:
            _fill(self._crops, crop_rows(crops, self._unedited.centre))
            self._held_crops = crops
        self.now = Editing(
            hides=edits.hides,
            palette=edits.palette if edits.adjusts else None,
            crops=crops,
            marks=self._shown_changes if matters else 0,
            highlight=highlight if transmittance else None,
            lit=self._lit_changes if transmittance else 0,
        )
        return self.now

    def _update_marks(self, edits: SceneEdits) -> None:
        run = (0, len(edits.marks))
        if self._source is None:
            self._marks.reserve(len(edits.marks))
            self._held = np.zeros_like(edits.marks)
            self._marks.write(self._held)
        elif edits.marks is self._source:
            run = edits.changed_since(self._version) or run
        start, stop = run
        new = edits.marks[start:stop]
        changed = _difference(new, self._held[start:stop])
        if changed:
            self._held[start:stop] = new
            self._marks.write(self._held[start:stop], start)
            self.marks_uploaded += stop - start
            self._shown_changes += bool(changed & ~ONLY_LIT_UP)
            self._lit_changes += bool(changed & ONLY_LIT_UP)
        self._source, self._version = edits.marks, edits.marks_version

    def use(self, program: moderngl.Program | moderngl.ComputeShader) -> None:
        """Binds what `program`, a variant by the flags of `now`, reads."""
        now = self.now
        arrays = {"u_marks": self._marks, "u_palette": self._palette, "u_crops": self._crops}
        for unit, (name, array) in enumerate(arrays.items(), start=FIRST_UNIT):
            if program.get(name, None) is not None:
                # A general program has all three: no two kinds of textures may share a unit, and llvmpipe
                # compiles it once more for a unit that had none.
                array.reserve(1)
                array.texture.use(unit)
                set_uniforms(program, {name: unit})
        set_uniforms(program, {"u_last_adjustment": len(now.palette or (None,)) - 1})
        set_uniforms(program, {"u_crop_count": len(now.crops)})
        if now.highlight is not None:
            set_uniforms(program, {"u_tints": tuple(tuple(row) for row in now.highlight.table.tolist())})

    @property
    def placement(self) -> Placement:
        """Where the edits have put the scene."""
        places = self.now.places
        if places is None or self._source is None:
            return self._unedited
        if self._moved is None or self._moved[0] != places:
            step = sample_step(len(self._means))
            # Marks may be newer than the palette.
            marks = np.minimum(self._held[::step], (len(places[0]) << PALETTE_SHIFT) - 1)
            moved = adjusted_points(self._means[::step], marks, places[0])
            self._moved = (places, placement_of(moved))
        return self._moved[1]

    def release(self) -> None:
        for array in (self._marks, self._palette, self._crops):
            array.release()


def _difference(new: np.ndarray, old: np.ndarray) -> int:
    """Bits in which some mark differs."""
    bits = 0
    for start in range(0, len(new), SLICE):
        part = slice(start, start + SLICE)
        bits |= int(np.bitwise_or.reduce(new[part] ^ old[part]))
    return bits


def _fill(array: TexelArray, rows: np.ndarray) -> None:
    """Writes rows of numbers as texels of four."""
    with np.errstate(over="ignore"):
        texels = rows.astype(np.float32).reshape(-1, 4)
    array.reserve(len(texels))
    array.write(texels)
