"""Contexts without a window, and what is said where there is none."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any, cast

import moderngl
import pytest

from splatview.renderers import make_renderer
from splatview.renderers.gl import context
from splatview.renderers.gl.context import GL_VERSIONS, create_headless_context, describe
from splatview.scene import InputError

linux_only = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="EGL is for Linux")


LIMITS = {"GL_MAX_COMPUTE_SHADER_STORAGE_BLOCKS": 16, "GL_MAX_VERTEX_SHADER_STORAGE_BLOCKS": 16}


class FakeContext:
    """What `context` reads of a real one."""

    def __init__(self, renderer: str, version_code: int, limits: dict[str, int]) -> None:
        named = {"GL_VENDOR": "someone", "GL_RENDERER": renderer, "GL_VERSION": "as they call it"}
        self.info = named | LIMITS | limits
        self.version_code = version_code
        self.released = False

    def __enter__(self) -> FakeContext:
        return self

    def __exit__(self, *_: object) -> None: ...

    def release(self) -> None:
        self.released = True


def fake_context(renderer: str, version_code: int = 330, **limits: int) -> moderngl.Context:
    return cast(moderngl.Context, FakeContext(renderer, version_code, limits))


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
        ("D3D12 (Microsoft Basic Render Driver)", True),
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


@pytest.mark.parametrize(
    ("limits", "compute"),
    [
        ({}, True),
        ({"GL_MAX_COMPUTE_SHADER_STORAGE_BLOCKS": 8}, True),
        ({"GL_MAX_COMPUTE_SHADER_STORAGE_BLOCKS": 7}, False),
        ({"GL_MAX_VERTEX_SHADER_STORAGE_BLOCKS": 0}, False),
    ],
)
def test_compute_needs_storage_blocks_in_both_stages(limits, compute):
    assert describe(fake_context("some GPU", 450, **limits)).has_compute is compute


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch):
    """`driver({device index: (renderer, newest version)})`: what there is; returns what is asked of it."""
    monkeypatch.delenv("GLCONTEXT_DEVICE_INDEX", raising=False)
    asked: list[tuple[int, int]] = []
    made: list[Any] = []

    def install(devices: dict[int, tuple[str, int]]):
        def create(*, require: int, device_index: int = 0, **_: Any) -> moderngl.Context:
            asked.append((device_index, require))
            if device_index not in devices:
                raise Exception(f"requested device index {device_index}, but found {len(devices)} devices")
            renderer, newest = devices[device_index]
            if require > newest:
                raise Exception("eglCreateContext failed (0x3009)")
            # As NVIDIA's driver does: exactly what was asked for.
            made.append(fake_context(renderer, require))
            return made[-1]

        monkeypatch.setattr(moderngl, "create_context", create)
        return asked, made

    return install


@linux_only
def test_the_newest_version_is_asked_for_first(driver):
    asked, _ = driver({0: ("NVIDIA H200/PCIe/SSE2", 460)})
    assert create_headless_context().version_code == 450
    assert asked == [(0, 450)]


@linux_only
def test_older_versions_are_asked_for_in_turn(driver):
    asked, _ = driver({0: ("Mesa Intel(R) HD Graphics 3000", 330)})
    assert create_headless_context().version_code == 330
    assert [version for _, version in asked] == [450, 430, 410, 330]


@linux_only
@pytest.mark.parametrize(
    ("devices", "chosen"),
    [
        ({0: ("llvmpipe", 450), 1: ("NVIDIA RTX 4070", 450)}, 1),
        ({0: ("a card of somebody else", 0), 1: ("llvmpipe", 450), 2: ("AMD Radeon", 450)}, 2),
        ({0: ("llvmpipe", 450), 1: ("softpipe", 330)}, 0),
        ({0: ("NVIDIA RTX 4070", 450), 1: ("AMD Radeon", 450)}, 0),
    ],
)
def test_of_several_devices_one_with_a_gpu_is_taken(driver, devices, chosen):
    _, made = driver(devices)
    taken = create_headless_context()
    assert taken.info["GL_RENDERER"] == devices[chosen][0]
    assert all(context.released for context in made if context is not taken)


@linux_only
def test_a_device_named_by_the_environment_is_the_only_one_tried(driver, monkeypatch):
    monkeypatch.setenv("GLCONTEXT_DEVICE_INDEX", "1")
    asked, _ = driver({0: ("llvmpipe", 450)})
    create_headless_context()
    assert asked == [(0, 450)]  # glcontext itself replaces the index


def test_windows_ask_for_the_same_versions(monkeypatch):
    from splatview.viewer import platform

    asked: list[int] = []
    hints: dict[int, int] = {}
    monkeypatch.setattr(platform.glfw, "init", lambda: True)
    monkeypatch.setattr(platform.glfw, "terminate", lambda: None)
    monkeypatch.setattr(platform.glfw, "get_error", lambda: (0, b"too new"))
    monkeypatch.setattr(platform.glfw, "default_window_hints", hints.clear)
    monkeypatch.setattr(platform.glfw, "window_hint", hints.__setitem__)

    def create(*_: Any) -> None:
        major, minor = (
            hints[getattr(platform.glfw, f"CONTEXT_VERSION_{part}")] for part in ("MAJOR", "MINOR")
        )
        asked.append(100 * major + 10 * minor)

    monkeypatch.setattr(platform.glfw, "create_window", create)
    with pytest.raises(InputError, match="no window with OpenGL"):
        platform.best_gl_version()
    assert tuple(asked) == GL_VERSIONS


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


@pytest.mark.parametrize(
    ("nodes", "library", "allowed", "named"),
    [
        ([], False, True, None),
        (["/dev/nvidiactl"], False, True, "an NVIDIA GPU is here without its OpenGL driver"),
        (["/dev/nvidiactl"], True, True, None),
        (["/dev/dri/renderD128", "/dev/dri/renderD129"], False, True, None),
        (["/dev/dri/renderD128"], False, False, "may not use the GPU at /dev/dri/renderD128: usermod"),
    ],
)
def test_a_gpu_that_opengl_cannot_reach_is_named(monkeypatch, nodes, library, allowed, named):
    def load(name: str) -> None:
        if not library:
            raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(context.os.path, "exists", lambda path: path in nodes)
    monkeypatch.setattr(context, "glob", lambda _: [node for node in nodes if "dri" in node])
    monkeypatch.setattr(context.os, "access", lambda *_: allowed)
    monkeypatch.setattr(context.ctypes, "CDLL", load)
    assert named is None or named in (context.unused_gpu() or "")
    assert named is not None or context.unused_gpu() is None


@pytest.mark.parametrize(
    ("version", "limits", "lacking"),
    [
        (450, {}, None),
        (330, {}, "OpenGL is 3.3, 4.3 is needed"),
        (430, {"GL_MAX_COMPUTE_SHADER_STORAGE_BLOCKS": 7}, "a compute shader has 7 storage blocks"),
        (450, {"GL_MAX_VERTEX_SHADER_STORAGE_BLOCKS": 0}, "a vertex shader has 0 storage blocks"),
    ],
)
def test_what_compute_shaders_lack_is_named(version, limits, lacking):
    found = context.missing_compute(fake_context("some GPU", version, **limits))
    assert (lacking or "") in (found or "") and (lacking is None) is (found is None)


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
