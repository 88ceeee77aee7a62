"""Graphics memory runs out: one line says so, the old scene stays shown, and what was taken is given back.

The driver's two ways to refuse are injected at every single allocation (moderngl fails, or OpenGL only notes
GL_OUT_OF_MEMORY, which moderngl does not look at); and once the memory of the process is really limited, in
which llvmpipe keeps its buffers.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import moderngl
import numpy as np
import pytest

from splatview.renderers.gl.context import create_headless_context, held_bytes
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.renderer import GLRenderer
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, Gaussians, InputError, look_at

MOST_ALLOCATIONS = 60


@pytest.fixture(scope="module")
def ctx() -> Iterator[moderngl.Context]:
    try:
        made = create_headless_context(require=430)
    except InputError as error:
        pytest.skip(str(error))
    with made:
        yield made
        assert made.error == "GL_NO_ERROR"


@pytest.fixture
def camera() -> Camera:
    return look_at((0, 0, -3), (0, 0, 0), up=(0, -1, 0), width=64, height=48)


class Refusing:
    """Lets so many buffers and textures be made, and no more."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, quietly: bool):
        self.left = sys.maxsize
        self.refused = False
        self.quietly = quietly
        self._noted = False
        for name in ("buffer", "texture", "texture_array", "depth_renderbuffer"):
            monkeypatch.setattr(moderngl.Context, name, self._limited(getattr(moderngl.Context, name)))
        real: Any = moderngl.Context.error
        monkeypatch.setattr(moderngl.Context, "error", property(lambda ctx: self._error(real.__get__(ctx))))

    def _limited(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def make(ctx: moderngl.Context, *arguments: Any, **options: Any) -> Any:
            self.left -= 1
            if self.left >= 0:
                return real(ctx, *arguments, **options)
            self.refused = True
            if not self.quietly:
                raise moderngl.Error("out of memory")
            self._noted = True
            return real(ctx, *arguments, **options)

        return make

    def _error(self, real: str) -> str:
        noted, self._noted = self._noted, False
        return "GL_OUT_OF_MEMORY" if noted else real


@pytest.mark.parametrize("quietly", [False, True], ids=["moderngl fails", "OpenGL notes it"])
@pytest.mark.parametrize("kind", [QuadsRenderer, TilesRenderer, QuadsGL33Renderer])
def test_whatever_allocation_is_refused_the_old_scene_stays(
    ctx: moderngl.Context,
    camera: Camera,
    kind: type[GLRenderer],
    quietly: bool,
    monkeypatch: pytest.MonkeyPatch,
    random_gaussians: Callable[..., Gaussians],
) -> None:
    small, large = random_gaussians(40, sh_degree=1), random_gaussians(5000, sh_degree=1, seed=1)
    elsewhere = look_at((1, 0, -3), (0, 0, 0), up=(0, -1, 0), width=64, height=48)
    renderer = kind(ctx)
    before, aside = (
        renderer.render(FrameRequest(small, camera)),
        renderer.render(FrameRequest(small, elsewhere)),
    )
    refusing = Refusing(monkeypatch, quietly=quietly)
    for allowed in range(MOST_ALLOCATIONS):
        held = held_bytes(renderer)
        refusing.left, refusing.refused = allowed, False
        try:
            renderer.load(large)
        except InputError as error:
            assert "graphics memory" in str(error) and "\n" not in str(error)
        refusing.left = sys.maxsize
        if not refusing.refused:
            break
        assert held_bytes(renderer) == held, f"after {allowed} allocations"
        # Both views: one might be a picture that is still there.
        np.testing.assert_array_equal(renderer.render(FrameRequest(small, camera)), before)
        np.testing.assert_array_equal(renderer.render(FrameRequest(small, elsewhere)), aside)
    else:
        pytest.fail("loading never succeeds")
    assert allowed > 5
    assert np.isfinite(renderer.render(FrameRequest(large, camera))).all()
    renderer.close()


@pytest.mark.parametrize("kind", [QuadsRenderer, TilesRenderer, QuadsGL33Renderer])
def test_a_picture_without_room_is_tried_again(
    ctx: moderngl.Context,
    camera: Camera,
    kind: type[GLRenderer],
    monkeypatch: pytest.MonkeyPatch,
    random_gaussians: Callable[..., Gaussians],
) -> None:
    scene = random_gaussians(300)
    whole = kind(ctx)
    wanted = whole.render(FrameRequest(scene, camera))
    whole.close()
    refusing = Refusing(monkeypatch, quietly=False)
    allowed = 0
    for allowed in range(MOST_ALLOCATIONS):
        renderer = kind(ctx)
        renderer.load(scene)
        refusing.left, refusing.refused = allowed, False
        try:
            image = renderer.render(FrameRequest(scene, camera))
        except InputError as error:
            assert "graphics memory" in str(error)
            refusing.left = sys.maxsize
            image = renderer.render(FrameRequest(scene, camera))
        refusing.left = sys.maxsize
        np.testing.assert_array_equal(image, wanted)
        renderer.close()
        if not refusing.refused:
            break
    assert 2 <= allowed < MOST_ALLOCATIONS - 1


LIMITED = """
import resource, sys
import numpy as np
from splatview.scene import Gaussians, InputError, look_at
from splatview.renderers.gl.context import create_headless_context
from splatview.renderers.gl.context import held_bytes
from splatview.renderers import FrameRequest
from splatview.viewer.picture import Picture

def scene(n):
    rng = np.random.default_rng(1)
    return Gaussians(
        means=rng.normal(size=(n, 3)).astype(np.float32),
        quats=np.ones((n, 4), np.float32),
        log_scales=np.full((n, 3), -4, np.float32),
        opacity_logits=np.zeros(n, np.float32),
        sh=np.zeros((n, 1, 3), np.float32),
    )

small, large = scene(500), scene(1_500_000)
picture = Picture(create_headless_context(), "quads")
first, second = (look_at((x, 0, -3), (0, 0, 0), up=(0, -1, 0), width=96, height=64) for x in (0, 1))
list(picture.load_steps(small))
wanted = [picture.read(FrameRequest(None, camera)) for camera in (first, second)]
held = held_bytes(picture)
pages = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
for mib in map(int, sys.argv[1:]):
    resource.setrlimit(resource.RLIMIT_AS, (pages + mib * 2**20, resource.RLIM_INFINITY))
    try:
        for _ in picture.load_steps(large):
            pass
        print("loaded")
    except InputError as error:
        print(error)
    resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    assert held_bytes(picture) == held
    for camera, picture_before in zip((first, second), wanted):
        assert np.array_equal(picture.read(FrameRequest(None, camera)), picture_before)
for _ in picture.load_steps(large):
    pass
print("loaded in the end")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of address space")
def test_memory_that_really_runs_out(ctx: moderngl.Context) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, "20", "60", "110", "150"],
        capture_output=True,
        text=True,
        timeout=200,
        env=dict(os.environ, LIBGL_ALWAYS_SOFTWARE="1"),
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    *refused, last = done.stdout.splitlines()
    assert last == "loaded in the end"
    assert len(refused) == 4 and all("memory" in line for line in refused)
    assert any("1,500,000 splats need" in line for line in refused), "the driver's refusal is seen"
