"""Programs by their flags: the specialised one, or until that is at hand the general one.

A specialised program has the instructions of what its flags ask for and no others. A general one has all,
and takes the flags from uniforms: it can stand in for every other, at once and for a while.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import moderngl

from .programs import Flags, fixed_flags, load_compute, load_render_program, switch_values, switches
from .view_uniforms import set_uniforms


@dataclass(frozen=True)
class Variant:
    """What a program is made of."""

    files: tuple[str, ...]
    """Paths under ``shaders/``: one of a compute shader, or of a vertex and a fragment shader."""
    flags: frozenset[tuple[str, float | bool]]
    general: bool = False

    @staticmethod
    def of(files: tuple[str, ...], flags: Flags) -> Variant:
        return Variant(files, frozenset(flags.items()))

    @property
    def generally(self) -> Variant:
        """The general program that can stand in for this one."""
        fixed = fixed_flags(dict(self.flags))
        # The names of the others stay, as they decide what is declared.
        named = {flag: False for flag, _ in self.flags if flag in switches()}
        return Variant(self.files, frozenset({**fixed, **named}.items()), True)


@dataclass
class Made:
    """A program and what it is used through."""

    program: moderngl.Program | moderngl.ComputeShader
    arrays: dict[int, moderngl.VertexArray] = field(default_factory=dict)
    """By the index buffer that is drawn, 0 for none."""

    def release(self) -> None:
        for array in self.arrays.values():
            array.release()
        self.program.release()


class Variants:
    """The programs of one renderer.

    `waits_for`: asked whether a specialised program should wait, because compiling it here and now would
    stall; where the general one has been compiled, that is used meanwhile. Without it, none waits.
    """

    def __init__(
        self, ctx: moderngl.Context, *, waits_for: Callable[[Variant], bool] = lambda variant: False
    ) -> None:
        self._ctx = ctx
        self._waits_for = waits_for
        self._made: dict[Variant, Made] = {}
        self._always_general = False
        self.waiting: set[Variant] = set()
        """Those for which general ones have stood in, see `take_waiting`."""

    def compute(self, file: str, flags: Flags) -> moderngl.ComputeShader:
        """A compute shader, ready to run.

        Raises:
            ShaderError: it does not compile.
        """
        program = self._chosen(Variant.of((file,), flags)).program
        assert isinstance(program, moderngl.ComputeShader)
        return program

    def drawing(
        self, vertex: str, fragment: str, flags: Flags, indices: moderngl.Buffer | None = None
    ) -> tuple[moderngl.Program, moderngl.VertexArray]:
        """A render program, with a vertex array that has no attributes and draws `indices` (uint32), if any.

        Raises:
            ShaderError: it does not compile.
        """
        made = self._chosen(Variant.of((vertex, fragment), flags))
        assert isinstance(made.program, moderngl.Program)
        key = indices.glo if indices is not None else 0
        if key not in made.arrays:
            made.arrays[key] = self._ctx.vertex_array(
                made.program, [], index_buffer=indices, index_element_size=4
            )
        return made.program, made.arrays[key]

    def take_waiting(self) -> frozenset[Variant]:
        """The variants that general programs have stood in for since the last call."""
        waiting, self.waiting = frozenset(self.waiting), set()
        return waiting

    @contextmanager
    def generally(self) -> Iterator[None]:
        """Within it every program is the general one."""
        before, self._always_general = self._always_general, True
        try:
            yield
        finally:
            self._always_general = before

    @property
    def made(self) -> frozenset[Variant]:
        """Those that have been compiled."""
        return frozenset(self._made)

    def _chosen(self, variant: Variant) -> Made:
        if not self._always_general and (variant in self._made or not self._must_wait(variant)):
            return self._compiled(variant)
        made = self._compiled(variant.generally)
        set_uniforms(made.program, switch_values(dict(variant.flags)))
        return made

    def _must_wait(self, variant: Variant) -> bool:
        waits = variant.generally in self._made and self._waits_for(variant)
        if waits:
            self.waiting.add(variant)
        return waits

    def _compiled(self, variant: Variant) -> Made:
        if variant not in self._made:
            self._made[variant] = Made(load(self._ctx, variant))
        return self._made[variant]

    def release(self) -> None:
        for made in self._made.values():
            made.release()
        self._made.clear()


def load(ctx: moderngl.Context, variant: Variant) -> moderngl.Program | moderngl.ComputeShader:
    """Compiles it.

    Raises:
        ShaderError: as `programs.load_compute`.
    """
    flags = dict(variant.flags)
    if len(variant.files) == 1:
        return load_compute(ctx, variant.files[0], flags, general=variant.general)
    vertex, fragment = variant.files
    return load_render_program(ctx, vertex, fragment, flags, general=variant.general)
