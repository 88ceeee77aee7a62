"""GLSL files to programs: includes, feature flags, and errors that name the file and line."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import resources

import moderngl

from ... import shaders

INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
ERROR_PLACE = re.compile(r"\b\d+(?::|\()(\d+)\b")
"""Where drivers put "source string number, line": Mesa 0:12(3), NVIDIA 0(12), Intel and Apple 0:12."""

COMPUTE_VERSION = 430
"""The oldest GL with compute shaders and shader storage buffers."""


class ShaderError(RuntimeError):
    """A shader of ours does not compile or link on this driver; the message names file and line."""


Origin = tuple[str, int]
"""A file under ``shaders/`` and a line in it, from 1."""


def expand(name: str, version: str, flags: Mapping[str, float | bool]) -> tuple[str, list[Origin]]:
    """Full source of shader `name` (a path under ``shaders/``), and where each of its lines came from.

    Writes ``#version``, then the flags as ``#define``s, then the file with every ``#include "path"``
    replaced by that file, each file once. Errors are traced by the list of origins rather than by ``#line``,
    whose file number Mesa 22 does not report back.

    A flag guards instructions as an expression, ``if (LIT)``: compilers drop what is under ``if (false)``.
    For declarations, which they may keep, a bool F also comes as HAS_F, 1 or 0: ``#if HAS_LIT``.
    """
    lines = [f"#version {version}"]
    for flag, value in sorted(flags.items()):
        lines.append(f"#define {flag} {_literal(value)}")
        if isinstance(value, bool):
            lines.append(f"#define HAS_{flag} {int(value)}")
    origins = [("(flags)", number) for number in range(1, len(lines) + 1)]
    _append(name, "(loader)", set(), lines, origins)
    return "\n".join(lines) + "\n", origins


def _literal(value: float | bool) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    # A float needs its point: GLSL has no implicit conversion from int in every place.
    return repr(float(value)) if isinstance(value, float) else str(int(value))


def _append(name: str, includer: str, seen: set[str], lines: list[str], origins: list[Origin]) -> None:
    seen.add(name)
    try:
        source = resources.files(shaders).joinpath(name).read_text(encoding="utf8")
    except FileNotFoundError as error:
        raise ShaderError(f"{includer}: there is no shader file {name}") from error
    for number, line in enumerate(source.splitlines(), start=1):
        match = INCLUDE.match(line)
        if match is None:
            lines.append(line)
            origins.append((name, number))
        elif match[1] not in seen:
            _append(match[1], f"{name}:{number}", seen, lines, origins)


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
    ctx: moderngl.Context, vertex: str, fragment: str, flags: Mapping[str, float | bool] | None = None
) -> moderngl.Program:
    """A vertex and a fragment shader, paths under ``shaders/``, compiled with `flags` as ``#define``s.

    Raises:
        ShaderError: it does not compile; a defect of ours or of the driver, never of the user.
    """
    version = _version(ctx)
    vertex_source, vertex_origins = expand(vertex, version, flags or {})
    fragment_source, fragment_origins = expand(fragment, version, flags or {})
    try:
        return ctx.program(vertex_shader=vertex_source, fragment_shader=fragment_source)
    except moderngl.Error as error:
        origins = fragment_origins if "fragment_shader" in str(error) else vertex_origins
        raise _explain(error, origins) from error


class RenderPrograms:
    """Render programs, each with a vertex array that has no attributes; compiled when first asked for."""

    def __init__(self, ctx: moderngl.Context, indices: moderngl.Buffer | None = None) -> None:
        self._ctx = ctx
        self._indices = indices
        self._made: dict[object, tuple[moderngl.Program, moderngl.VertexArray]] = {}

    def get(
        self, vertex: str, fragment: str, flags: Mapping[str, float | bool]
    ) -> tuple[moderngl.Program, moderngl.VertexArray]:
        """The variant by `flags`, as of `load_render_program`; it draws the indices (uint32), if any.

        Raises:
            ShaderError: it does not compile.
        """
        variant = (vertex, fragment, frozenset(flags.items()))
        if variant not in self._made:
            program = load_render_program(self._ctx, vertex, fragment, flags)
            array = self._ctx.vertex_array(program, [], index_buffer=self._indices, index_element_size=4)
            self._made[variant] = program, array
        return self._made[variant]

    def release(self) -> None:
        for program, array in self._made.values():
            array.release()
            program.release()
        self._made.clear()


def load_compute(
    ctx: moderngl.Context, name: str, flags: Mapping[str, float | bool] | None = None
) -> moderngl.ComputeShader:
    """A compute shader, a path under ``shaders/``, compiled with `flags` as ``#define``s (GL 4.3).

    Raises:
        ShaderError: it does not compile.
    """
    source, origins = expand(name, f"{COMPUTE_VERSION} core", flags or {})
    try:
        return ctx.compute_shader(source)
    except moderngl.Error as error:
        raise _explain(error, origins) from error
