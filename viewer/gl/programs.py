"""GLSL files to programs: includes, feature flags, and errors that name the file and line."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
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


def _append(name: str, includer: str, seen: set[str], lines: list[str], origins: list[Origin]) -> None:
    seen.add(name)
    try:
        source = _read(name)
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
