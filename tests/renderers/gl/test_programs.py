"""Shader files to programs: includes, flags, and errors that name the place."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from splatview.renderers.gl import programs
from splatview.renderers.gl.programs import ShaderError, expand, load_compute, load_render_program

VERTEX = "void main() { gl_Position = vec4(gl_VertexID * 2 - 1, gl_VertexID % 2 * 4 - 1, 0.0, 1.0); }\n"


@pytest.fixture
def shader_folder(tmp_path, monkeypatch) -> Path:
    """A folder that takes the place of shaders/."""
    monkeypatch.setattr(programs.resources, "files", lambda package: tmp_path)
    monkeypatch.setattr(programs, "_lines", cache(programs._lines.__wrapped__))
    (tmp_path / "common").mkdir()
    return tmp_path


def test_version_flags_and_includes_come_in_order(shader_folder):
    (shader_folder / "common/a.glsl").write_text("float a;\n")
    (shader_folder / "main.glsl").write_text('// first\n#include "common/a.glsl"\nvoid main() {}\n')
    source, origins = expand("main.glsl", "330 core", {"WIDE": 2.0, "LIT": True, "COUNT": 3})
    assert source.splitlines() == [
        "#version 330 core",
        "#define COUNT 3",
        "#define LIT true",
        "#define HAS_LIT 1",
        "#define WIDE 2.0",
        "// first",
        "float a;",
        "void main() {}",
    ]
    assert origins[5:] == [("main.glsl", 1), ("common/a.glsl", 1), ("main.glsl", 3)]


def test_each_file_comes_once_even_in_a_circle(shader_folder):
    (shader_folder / "common/a.glsl").write_text('#include "common/b.glsl"\nfloat a;\n')
    (shader_folder / "common/b.glsl").write_text('#include "common/a.glsl"\nfloat b;\n')
    (shader_folder / "main.glsl").write_text('#include "common/a.glsl"\n#include "common/b.glsl"\n')
    source, _ = expand("main.glsl", "330 core", {})
    assert source.splitlines()[1:] == ["float b;", "float a;"]


def test_a_missing_include_names_the_line_that_wants_it(shader_folder):
    (shader_folder / "main.glsl").write_text('\n#include "common/gone.glsl"\n')
    with pytest.raises(ShaderError, match=r"main\.glsl:2: there is no shader file common/gone\.glsl"):
        expand("main.glsl", "330 core", {})


@pytest.mark.parametrize("broken", ["vertex", "fragment"])
def test_an_error_names_file_and_line(ctx, shader_folder, broken):
    (shader_folder / "common/bad.glsl").write_text("\n\nfloat f() { return undeclared; }\n")
    include = '#include "common/bad.glsl"\n'
    (shader_folder / "v.glsl").write_text((include if broken == "vertex" else "") + VERTEX)
    (shader_folder / "f.glsl").write_text(
        (include if broken == "fragment" else "") + "out vec4 c;\nvoid main() { c = vec4(1.0); }\n"
    )
    with pytest.raises(ShaderError, match=r"common/bad\.glsl:3"):
        load_render_program(ctx, "v.glsl", "f.glsl", {"SOME": 1})


def test_an_error_in_a_compute_shader_names_file_and_line(ctx, shader_folder):
    (shader_folder / "c.glsl").write_text("layout(local_size_x = 1) in;\nvoid main() {\n    nothing();\n}\n")
    with pytest.raises(ShaderError, match=r"c\.glsl:3"):
        load_compute(ctx, "c.glsl")


def test_flags_reach_a_compute_shader(ctx, shader_folder):
    (shader_folder / "c.glsl").write_text(
        "layout(local_size_x = 1) in;\n"
        "layout(std430, binding = 0) buffer Out { float values[]; };\n"
        "void main() {\n    if (LIT) values[0] = SIZE + float(COUNT);\n}\n"
    )
    result = ctx.buffer(np.zeros(1, np.float32))
    result.bind_to_storage_buffer(0)
    load_compute(ctx, "c.glsl", {"LIT": True, "SIZE": 0.5, "COUNT": 7}).run()
    ctx.memory_barrier()
    assert np.frombuffer(result.read(), np.float32)[0] == 7.5
    load_compute(ctx, "c.glsl", {"LIT": False, "SIZE": 0.5, "COUNT": 9}).run()
    ctx.memory_barrier()
    assert np.frombuffer(result.read(), np.float32)[0] == 7.5


def test_every_shader_says_no_version_and_includes_what_is_there():
    """The loader writes the version; an include that leads nowhere fails here, not on a user's machine."""
    from splatview import shaders

    root = Path(shaders.__path__[0])
    files = sorted(root.rglob("*.glsl"))
    assert files
    for path in files:
        source, _ = expand(path.relative_to(root).as_posix(), "430 core", {})
        assert source.count("#version") == 1, path
