"""An order by depth that serves more frames than the one it was made for, on the GPU.

It is one of all splats, seen or not, so that those that come into view have their place. A frame's visible
splats are taken from it in place of from the indices, and need no sort then.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import moderngl
import numpy as np

from ...scene.resorting import Resorting
from .edit_textures import EditTextures
from .memory import reserve
from .programs import load_compute
from .scene_buffers import GROUP_SIZE, SceneBuffers
from .sort import RadixSort
from .variants import Variants
from .view_uniforms import Uniform, set_uniforms

if TYPE_CHECKING:
    from .projector import DepthKeys


class KeptOrder:
    """Has no memory until it is first used."""

    def __init__(self, ctx: moderngl.Context, variants: Variants) -> None:
        self._ctx, self._variants = ctx, variants
        self.resorting = Resorting()
        self._count_kept: moderngl.ComputeShader | None = None
        self._buffers: list[moderngl.Buffer] = []
        """Keys, splats, and their number."""
        self._sorter: RadixSort | None = None
        self._splats = 0
        self.order: moderngl.Buffer | None = None
        """All splats, front to back."""

    def start_anew(self) -> None:
        """Another scene is loaded."""
        self.resorting.forget()
        self._release_buffers()

    def make(
        self, scene: SceneBuffers, uniforms: dict[str, Uniform], edits: EditTextures, keys: DepthKeys
    ) -> None:
        """Sorts all splats of the scene."""
        if self._sorter is None:
            self._splats = scene.splats
            room = 4 * max(1, scene.splats)
            self._buffers = reserve(
                self._ctx, (room, room, 4), f"{scene.splats:,} splats in an order that is kept"
            )
            self._buffers[2].write(np.uint32(scene.splats).tobytes())
            self._sorter = RadixSort(self._ctx, scene.splats)
        flags = {
            "GROUP_SIZE": GROUP_SIZE,
            **dict.fromkeys(("ANTIALIASED", "LENS", "ORTHOGRAPHIC"), False),
            "ATTRIBUTES": scene.flags()["ATTRIBUTES"],
            **edits.now.flags(),
        }
        program = self._variants.compute("quads/depths.comp.glsl", flags)
        set_uniforms(program, uniforms)
        edits.use(program)
        shortened = {"u_key_base": keys.base, "u_key_shift": keys.shift, "u_key_most": (1 << keys.bits) - 1}
        for slot, buffer in enumerate(self._buffers[:2], start=4):
            buffer.bind_to_storage_buffer(slot)
        for page in scene.pages:
            page.positions.bind_to_storage_buffer(0)
            set_uniforms(program, {"u_page_first": page.first, "u_page_count": page.count, **shortened})
            program.run(-(-page.count // GROUP_SIZE))
        self._ctx.memory_barrier()
        sort_keys, splats, count = self._buffers
        self.order = self._sorter.sort(sort_keys, splats, count, key_bits=keys.bits)[1]
        self._ctx.memory_barrier()

    def count(self, depth_keys: moderngl.Buffer, group_counts: moderngl.Buffer) -> None:
        """Fills `group_counts` with how many are seen of each GROUP_SIZE of the order."""
        if self.order is None:
            raise RuntimeError("make() comes before count()")
        if self._count_kept is None:
            self._count_kept = load_compute(
                self._ctx, "quads/count_kept.comp.glsl", {"GROUP_SIZE": GROUP_SIZE}
            )
        for slot, buffer in enumerate((depth_keys, self.order, group_counts)):
            buffer.bind_to_storage_buffer(slot)
        set_uniforms(self._count_kept, {"u_splats": self._splats})
        if self._splats:
            self._count_kept.run(-(-self._splats // GROUP_SIZE))
        self._ctx.memory_barrier()

    def _release_buffers(self) -> None:
        for buffer in self._buffers:
            buffer.release()
        if self._sorter is not None:
            self._sorter.release()
        self._buffers, self._sorter, self.order = [], None, None

    def release(self) -> None:
        self._release_buffers()
        if self._count_kept is not None:
            self._count_kept.release()
