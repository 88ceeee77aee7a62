"""Contexts without a window, and what is said where there is none."""

from __future__ import annotations

import os
import subprocess
import sys
from types import SimpleNamespace
from typing import cast

import moderngl
import pytest

from splatview.renderers import make_renderer
from splatview.renderers.gl.context import create_headless_context, describe
from splatview.scene import InputError

linux_only = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="EGL is for Linux")


def fake_context(renderer: str, version_code: int = 330) -> moderngl.Context:
    info = {"GL_VENDOR": "someone", "GL_RENDERER": renderer, "GL_VERSION": "as they call it"}
    return cast(moderngl.Context, SimpleNamespace(info=info, version_code=version_code))


def test_describe_a_real_context(ctx):
    info = describe(ctx)
    assert info.version_code >= 430
    assert info.has_compute
    assert info.renderer
    assert info.version


@pytest.mark.parametrize(
    ("renderer", "software"),
    [
        ("llvmpipe (LLVM 15.0.6, 256 bits)", True),
        ("softpipe", True),
        ("Google SwiftShader", True),
        ("Apple Software Renderer", True),
        ("GDI Generic", True),
        ("NVIDIA H200/PCIe/SSE2", False),
        ("Mesa Intel(R) UHD Graphics 620 (KBL GT2)", False),
        ("AMD Radeon RX 7900 XTX (radeonsi, navi31, LLVM 15.0.6)", False),
        ("Apple M2", False),
    ],
)
def test_software_is_recognised(renderer, software):
    assert describe(fake_context(renderer)).is_software is software


@pytest.mark.parametrize(("version", "compute"), [(330, False), (410, False), (430, True), (460, True)])
def test_compute_comes_with_4_3(version, compute):
    assert describe(fake_context("some GPU", version)).has_compute is compute


@linux_only
@pytest.mark.parametrize(
    "missing", [{"GLCONTEXT_LINUX_LIBEGL": "libnothing.so"}, {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nothing"}]
)
def test_no_driver_is_one_clear_line(missing):
    script = (
        "from splatview.scene import InputError\n"
        "from splatview.renderers.gl.context import create_headless_context\n"
        "try: create_headless_context()\n"
        "except InputError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], env=os.environ | missing, capture_output=True, text=True, check=True
    )
    lines = done.stdout.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("no OpenGL 3.3 without a window here (")
    assert "apt-get install libegl1 libgl1-mesa-dri" in lines[0]


def test_a_version_that_nobody_has():
    with pytest.raises(InputError, match=r"no OpenGL 9\.9 without a window"):
        create_headless_context(require=990)


def test_the_renderer_suits_the_context(ctx):
    renderer = make_renderer("quads", ctx)
    assert type(renderer).__name__ == "QuadsRenderer"
    renderer.close()


def test_a_context_older_than_3_3_is_refused():
    with pytest.raises(InputError, match=r"OpenGL 3\.1 is too old, 3\.3 is needed"):
        make_renderer("quads", fake_context("some GPU", 310))
