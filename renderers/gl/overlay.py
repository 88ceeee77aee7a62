"""Layers over a picture, whoever made that: lines behind the scene, and centres and outlines of splats."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import moderngl
import numpy as np

from splatview.renderers.gl.context import check_room
from splatview.renderers.gl.edit_textures import Editing, EditTextures
from splatview.renderers.gl.programs import Flags, Variant, load
from splatview.renderers.gl.renderer import view_key
from splatview.renderers.gl.scene_buffers import placement_of
from splatview.renderers.gl.uniforms import ray_flags, set_uniforms, view_uniforms
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians
from splatview.scene.projection import sigmoid
from splatview.scene.sh import SH_C0

LINE_HALF_WIDTH = 0.6
"""Px."""

RING_HALF_WIDTH = 0.75
"""Px."""

LEAST_CENTRE, LARGEST_CENTRE, CENTRE_SPACING = 0.55, 2.2, 0.3
"""Radius of a centre: least and most, px, and in units of the distance of as many evenly spread ones."""

PAGE = 4_096
"""Splats drawn at once: between two, the window may take a frame. Of 500,000 without a GPU, outlines were
answered after 105 ms with 8,192, and 99 ms with these."""

CENTRE_COLOUR = (0.25, 0.55, 1.0)

LINE_FORMAT, LINE_ATTRIBUTES = "2f 1f 4f", ("a_place", "a_across", "a_colour")

SPLAT_ATTRIBUTES = {"a_position": 4, "a_quat": 4, "a_scale": 3, "a_colour": 3}
"""Numbers of each, float32, as a page has them for a splat."""


@dataclass(frozen=True, eq=False)
class Lines:
    """Straight pieces in a picture."""

    ends: np.ndarray
    """(L, 2, 2) float32, px."""
    colours: np.ndarray
    """(L, 2, 4) float32: RGB and opacity at either end."""
    shows_through: float
    """Share that is seen through opaque parts of the scene: a capture may cover the whole picture."""

    def vertices(self) -> np.ndarray:
        """(L, 6, 7) float32: two triangles each."""
        along = self.ends[:, 1] - self.ends[:, 0]
        length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-6)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1) / length
        width = LINE_HALF_WIDTH + 0.5
        corners = []
        for end, side in ((0, -1), (0, 1), (1, 1), (0, -1), (1, 1), (1, -1)):
            place = self.ends[:, end] + side * width * across
            offset = np.full((len(place), 1), side * width, np.float32)
            corners.append(np.concatenate([place, offset, self.colours[:, end]], axis=1))
        return np.stack(corners, axis=1).astype(np.float32)


class Layer:
    """A transparent picture of straight alpha, row 0 on top, and what draws into it."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._programs: dict[Variant, moderngl.Program] = {}
        self._target: tuple[moderngl.Texture, moderngl.Renderbuffer, moderngl.Framebuffer] | None = None

    @property
    def texture(self) -> moderngl.Texture:
        """What has been drawn so far."""
        if self._target is None:
            raise RuntimeError("draw() comes before texture")
        return self._target[0]

    def _fit(self, size: tuple[int, int]) -> moderngl.Framebuffer:
        if self._target is None or self._target[0].size != size:
            self._release_target()
            texture = self._ctx.texture(size, 4)
            depth = self._ctx.depth_renderbuffer(size)
            check_room(self._ctx, "what is drawn over the picture", 8 * size[0] * size[1])
            self._target = texture, depth, self._ctx.framebuffer([texture], depth)
        return self._target[2]

    def _program(self, name: str, flags: Flags) -> moderngl.Program:
        variant = Variant.of((f"overlay/{name}.vert.glsl", f"overlay/{name}.frag.glsl"), flags)
        if variant not in self._programs:
            program = load(self._ctx, variant)
            assert isinstance(program, moderngl.Program)
            self._programs[variant] = program
        return self._programs[variant]

    def _release_target(self) -> None:
        for thing in self._target or ():
            thing.release()
        self._target = None

    def close(self) -> None:
        """Gives all of it back."""
        self._release_target()
        for program in self._programs.values():
            program.release()
        self._programs.clear()


class LineLayer(Layer):
    """Lines behind a picture, whose alpha says what it covers."""

    def __init__(self, ctx: moderngl.Context) -> None:
        super().__init__(ctx)
        self._vertices: moderngl.Buffer | None = None

    def draw(self, parts: Sequence[Lines], behind: moderngl.Texture, size: tuple[int, int]) -> None:
        """Draws all lines of `parts` anew, in a picture of `size` px; they show where `behind` lets through.

        Raises:
            InputError: there is not enough graphics memory.
        """
        previous = self._ctx.detect_framebuffer()
        framebuffer = self._fit(size)
        framebuffer.use()
        framebuffer.clear(0.0, 0.0, 0.0, 0.0)
        program = self._program("lines", {})
        values = {"u_size": (float(size[0]), float(size[1])), "u_half_width": LINE_HALF_WIDTH}
        set_uniforms(program, {**values, "u_picture": 0})
        swizzle, behind.swizzle = behind.swizzle, "RGBA"
        behind.use(0)
        self._ctx.enable_only(moderngl.NOTHING)
        for lines in parts:
            if len(lines.ends):
                set_uniforms(program, {"u_shows_through": lines.shows_through})
                self._draw(program, np.ascontiguousarray(lines.vertices()))
        behind.swizzle = swizzle
        previous.use()

    def _draw(self, program: moderngl.Program, data: np.ndarray) -> None:
        if self._vertices is None or self._vertices.size < data.nbytes:
            if self._vertices is not None:
                self._vertices.release()
            self._vertices = self._ctx.buffer(reserve=data.nbytes, dynamic=True)
        self._vertices.orphan()
        self._vertices.write(data)
        array = self._ctx.vertex_array(program, [(self._vertices, LINE_FORMAT, *LINE_ATTRIBUTES)])
        array.render(moderngl.TRIANGLES, vertices=6 * len(data))
        array.release()

    def close(self) -> None:
        super().close()
        if self._vertices is not None:
            self._vertices.release()
            self._vertices = None


class SplatLayer(Layer):
    """Centres of splats, and their outlines: the ellipse of one standard deviation, nearer ones in front.

    It has a copy of the scene's geometry of its own, 56 bytes per splat, and draws a page of splats after
    another, so that a driver without a GPU does not stop the window.
    """

    def __init__(self, ctx: moderngl.Context) -> None:
        super().__init__(ctx)
        self._edits = EditTextures(ctx)
        self._pages: list[moderngl.Buffer | None] = []
        self._source: Gaussians | None = None
        self._placement = placement_of(np.zeros((0, 3)))
        self._key: object = None
        self._left: list[tuple[bool, int]] = []
        """What is still to be drawn: whether outlines, and the page."""

    @property
    def busy(self) -> bool:
        """Whether some splats of the latest picture are still to be drawn, by further calls of `draw`."""
        return bool(self._left)

    def draw(self, request: FrameRequest, *, centres: bool, rings: bool, seconds: float = math.inf) -> None:
        """Draws the centres and outlines (`rings`) of the request's scene for about `seconds`; what is left
        is drawn by the next calls for the same picture.

        Raises:
            InputError: there is not enough graphics memory.
        """
        until = time.perf_counter() + seconds
        camera, gaussians = request.camera, request.gaussians
        assert gaussians is not None
        previous = self._ctx.detect_framebuffer()
        framebuffer = self._fit((camera.width, camera.height))
        framebuffer.use()
        self._load(gaussians)
        editing = self._edits.update(request.edits, request.highlight)
        key = (
            *(view_key(camera), request.settings.model, centres, rings, id(self._target)),
            *(editing.footprints, editing.tints_of("points"), id(gaussians)),
        )
        if key != self._key:
            self._key = key
            framebuffer.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
            wanted = [flag for flag, asked in ((True, rings), (False, centres)) if asked]
            self._left = [(flag, page) for flag in wanted for page in range(len(self._pages))]
        while self._left:
            self._draw_page(request, editing, *self._left.pop(0))
            if seconds < math.inf:
                self._ctx.finish()
            if time.perf_counter() >= until:
                break
        previous.use()

    def _load(self, gaussians: Gaussians) -> None:
        """Makes this the scene; its pages are uploaded when they are drawn first."""
        if gaussians is self._source:
            return
        self._release_pages()
        self._placement = placement_of(gaussians.means, gaussians.log_scales)
        self._edits.load(self._placement, gaussians.means)
        self._source, self._pages = gaussians, [None] * -(-len(gaussians) // PAGE)

    def _page(self, index: int) -> moderngl.Buffer:
        page, gaussians = self._pages[index], self._source
        if page is not None:
            return page
        assert gaussians is not None
        some = slice(index * PAGE, (index + 1) * PAGE)
        means = gaussians.means[some]
        data = np.empty((len(means), 14), np.float32)
        with np.errstate(over="ignore", invalid="ignore"):
            data[:, :3] = self._placement.split(means)[0]
            data[:, 3] = sigmoid(gaussians.opacity_logits[some])
            data[:, 4:8] = gaussians.quats[some]
            data[:, 8:11] = np.exp(gaussians.log_scales[some])
            data[:, 11:] = np.clip(0.5 + SH_C0 * gaussians.sh[some, 0], 0, 1)
        made = self._pages[index] = self._ctx.buffer(data)
        check_room(self._ctx, f"outlines of {len(gaussians):,} splats", data.nbytes)
        return made

    def _draw_page(self, request: FrameRequest, editing: Editing, rings: bool, page: int) -> None:
        camera = request.camera
        uniforms = view_uniforms(camera, request.settings, self._placement.centre)
        flags = {
            "RINGS": rings,
            **ray_flags(uniforms),
            "ANTIALIASED": False,  # splats that are too faint with it have an outline, too
            **editing.flags(projects=True, shows="points"),
        }
        program = self._program("splats", flags)
        set_uniforms(program, uniforms)
        self._edits.use(program)
        spacing = math.sqrt(camera.width * camera.height / max(len(self._source or ()), 1))
        centre = min(max(CENTRE_SPACING * spacing, LEAST_CENTRE), LARGEST_CENTRE)
        own = {
            "u_radius": RING_HALF_WIDTH if rings else centre,
            "u_depth_unit": self._placement.radius,
            "u_centre_colour": CENTRE_COLOUR,
            "u_first": page * PAGE,
        }
        set_uniforms(program, own)
        # Compilers drop attributes that a variant does not use: their bytes are padding then.
        parts = ((name, count, name in program) for name, count in SPLAT_ATTRIBUTES.items())
        layout = [(name, f"{count}f" if used else f"{4 * count}x") for name, count, used in parts]
        names = [name for name, part in layout if part.endswith("f")]
        form = " ".join(part for _, part in layout) + "/i"
        self._ctx.enable_only(moderngl.DEPTH_TEST)
        self._ctx.depth_func = "<="
        buffer = self._page(page)
        array = self._ctx.vertex_array(program, [(buffer, form, *names)])
        array.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=buffer.size // (14 * 4))
        array.release()

    def _release_pages(self) -> None:
        for page in self._pages:
            if page is not None:
                page.release()
        self._pages, self._left, self._source, self._key = [], [], None, None

    def close(self) -> None:
        super().close()
        self._edits.release()
        self._release_pages()
