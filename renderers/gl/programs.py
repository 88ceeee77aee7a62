"""GLSL files to programs: includes, feature flags, and errors that name the file and line."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

import moderngl

from splatview import shaders
from splatview.renderers.gl.uniforms import set_uniforms

INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
ERROR_PLACE = re.compile(r"\b\d+(?::|\()(\d+)\b")
"""Where drivers put "source string number, line": Mesa 0:12(3), NVIDIA 0(12), Intel and Apple 0:12."""

COMPUTE_VERSION = 430
"""The oldest GL with compute shaders and shader storage buffers."""


class ShaderError(RuntimeError):
    """A shader of ours does not compile or link on this driver; the message names file and line."""


Origin = tuple[str, int]
"""A file under ``shaders/`` and a line in it, from 1."""

Flags = Mapping[str, float | bool]

SWITCHES_FILE = "common/switches.glsl"

SWITCH = re.compile(r"^#define (\w+) (u_\w+)$", re.MULTILINE)


@cache
def switches() -> dict[str, str]:
    """The flags that a general program takes from uniforms, and the names of those."""
    return dict(SWITCH.findall(_read(SWITCHES_FILE)))


def fixed_flags(flags: Flags) -> dict[str, float | bool]:
    """Those of `flags` that are fixed in a general program, too."""
    return {flag: value for flag, value in flags.items() if flag not in switches()}


def switch_values(flags: Flags) -> dict[str, float | bool]:
    """The uniforms that make a general program the one of `flags`."""
    return {uniform: flags[flag] for flag, uniform in switches().items() if flag in flags}


def expand(name: str, version: str, flags: Flags, *, general: bool = False) -> tuple[str, list[Origin]]:
    """Full source of shader `name` (a path under ``shaders/``), and where each of its lines came from.

    Writes ``#version``, then the flags as ``#define``s, then the file with every ``#include "path"``
    replaced by that file, each file once. Errors are traced by the list of origins rather than by ``#line``,
    whose file number Mesa 22 does not report back.

    A flag guards instructions as an expression, ``if (LIT)``: compilers drop what is under ``if (false)``.
    For declarations, which they may keep, a bool F also comes as HAS_F, 1 or 0: ``#if HAS_LIT``.
    In a `general` program all that ``common/switches.glsl`` names are expressions of uniforms, and are had.
    """
    lines = [f"#version {version}"]
    for flag, value in sorted(flags.items()):
        if general and flag in switches():
            lines.append(f"#define HAS_{flag} 1")
            continue
        lines.append(f"#define {flag} {_literal(value)}")
        if isinstance(value, bool):
            lines.append(f"#define HAS_{flag} {int(value)}")
    origins = [("(flags)", number) for number in range(1, len(lines) + 1)]
    seen: set[str] = set()
    if general:
        _append(SWITCHES_FILE, "(loader)", seen, lines, origins)
    _append(name, "(loader)", seen, lines, origins)
    return "\n".join(lines) + "\n", origins


def _literal(value: float | bool) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    # A float needs its point: GLSL has no implicit conversion from int in every place.
    return repr(float(value)) if isinstance(value, float) else str(int(value))


def _read(name: str) -> str:
    return resources.files(shaders).joinpath(name).read_text(encoding="utf8")


@cache
def _lines(name: str) -> tuple[tuple[str, str | None], ...]:
    """Each line of a file, and the file that it includes; read once, as a window compiles dozens of programs
    of the same files."""
    found = ((line, INCLUDE.match(line)) for line in _read(name).splitlines())
    return tuple((line, match[1] if match else None) for line, match in found)


def _append(name: str, includer: str, seen: set[str], lines: list[str], origins: list[Origin]) -> None:
    seen.add(name)
    try:
        source = _lines(name)
    except FileNotFoundError as error:
        raise ShaderError(f"{includer}: there is no shader file {name}") from error
    for number, (line, included) in enumerate(source, start=1):
        if included is None:
            lines.append(line)
            origins.append((name, number))
        elif included not in seen:
            _append(included, f"{name}:{number}", seen, lines, origins)


def _version(ctx: moderngl.Context) -> str:
    return f"{COMPUTE_VERSION if ctx.version_code >= COMPUTE_VERSION else 330} core"


def _explain(error: moderngl.Error, origins: list[Origin]) -> ShaderError:
    def place(match: re.Match[str]) -> str:
        number = int(match[1])
        if not 1 <= number <= len(origins):
            return match[0]
        name, line = origins[number - 1]
        return f"{name}:{line}"

    return ShaderError(ERROR_PLACE.sub(place, str(error)).strip())


def load_render_program(
    ctx: moderngl.Context, vertex: str, fragment: str, flags: Flags | None = None, *, general: bool = False
) -> moderngl.Program:
    """A vertex and a fragment shader, paths under ``shaders/``, compiled with `flags`, see `expand`.

    Raises:
        ShaderError: it does not compile; a defect of ours or of the driver, never of the user.
    """
    version = _version(ctx)
    vertex_source, vertex_origins = expand(vertex, version, flags or {}, general=general)
    fragment_source, fragment_origins = expand(fragment, version, flags or {}, general=general)
    try:
        return ctx.program(vertex_shader=vertex_source, fragment_shader=fragment_source)
    except moderngl.Error as error:
        origins = fragment_origins if "fragment_shader" in str(error) else vertex_origins
        raise _explain(error, origins) from error


def load_compute(
    ctx: moderngl.Context, name: str, flags: Flags | None = None, *, general: bool = False
) -> moderngl.ComputeShader:
    """A compute shader, a path under ``shaders/``, compiled with `flags`, see `expand` (GL 4.3).

    Raises:
        ShaderError: it does not compile.
    """
    source, origins = expand(name, f"{COMPUTE_VERSION} core", flags or {}, general=general)
    try:
        return ctx.compute_shader(source)
    except moderngl.Error as error:
        raise _explain(error, origins) from error


def most_groups(ctx: moderngl.Context) -> int:
    """Work groups of a dispatch in its first dimension, 65,535 at least."""
    return int(ctx.info["GL_MAX_COMPUTE_WORK_GROUP_COUNT"][0])


def run_groups(program: moderngl.ComputeShader, groups: int) -> None:
    """Runs `groups` work groups, which know their numbers by ``common/groups.glsl``, and perhaps a few more.

    What a driver refuses is not drawn, without a word: too many groups, and none in a dimension.
    """
    rows = -(-groups // most_groups(program.ctx))
    if rows:
        program.run(-(-groups // rows), rows)


# Programs by their flags: the specialised one, or until that is at hand the general one.
#
# A specialised program has the instructions of what its flags ask for and no others. A general one has all,
# and takes the flags from uniforms: it can stand in for every other, at once and for a while.


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
