"""Gaussians to pixels on the CPU: numba kernels, forward and backward. Imports numpy, numba and scene."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial

import numpy as np

from splatview.raster.camera_models import make_optics
from splatview.raster.compiling import available_threads, will_compile
from splatview.raster.edits import edit_arrays
from splatview.raster.forward import EARLY_STOP
from splatview.raster.forward_per_pixel import depth_slopes
from splatview.raster.frame import Frame, Repaint, draw
from splatview.raster.parameters import (
    NonzeroBands,
    Parameters,
    make_view,
    nonzero_bands,
    parameters_of,
    used_degree,
)
from splatview.raster.sort import ReusableOrder, Workspace
from splatview.raster.surfels import make_surfels
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.background import composite_over
from splatview.scene.edits import SceneEdits
from splatview.scene.order_reuse import keeps_order

ORDERS = ("32-bit", "16-bit", "per-pixel")


class _ThreadState(threading.local):
    def __init__(self) -> None:
        self.workspace = Workspace()
        self.depth_order = ReusableOrder()


_thread_state = _ThreadState()


def render(
    gaussians: Gaussians,
    camera: Camera,
    settings: RenderSettings | None = None,
    *,
    edits: SceneEdits | None = None,
    threads: int | None = None,
    stages: dict[str, float] | None = None,
    on_compile: Callable[[], None] | None = None,
) -> np.ndarray:
    """The picture, float32 (H, W, 4): RGB over the background, alpha = 1 - T.

    `edits` are shown as `scene.edits.bake` would make them, without the copy; the selection is not
    highlighted.

    `threads`: number of threads, this one included; None: all cores. `stages`, if given, receives the
    milliseconds of "project", "sort", "bin" and "forward". `on_compile` is called first when kernels have to
    be compiled, which takes some seconds, once per installation.

    The picture is within 1e-4 of `scene.reference` but for pixels where an alpha lies so close to the
    cut that rounding decides.
    """
    if on_compile is not None and will_compile():
        on_compile()
    frame = draw_frame(
        parameters_of(gaussians),
        camera,
        settings or RenderSettings(),
        _thread_state.workspace,
        depth_order=_thread_state.depth_order,
        edits=edits,
        nonzero=nonzero_bands(gaussians),
        threads=threads,
    )
    if stages is not None:
        stages.update(frame.milliseconds)
    return frame.image


def forget_order() -> None:
    """Lets the next `render` of this thread sort anew, whatever the settings' `resort_frames`."""
    _thread_state.depth_order.resort_policy.forget()


def draw_frame(
    splats: Parameters,
    camera: Camera,
    settings: RenderSettings,
    workspace: Workspace,
    *,
    depth_order: ReusableOrder | None = None,
    edits: SceneEdits | None = None,
    nonzero: NonzeroBands | None = None,
    background: np.ndarray | None = None,
    dtype: type[np.floating] = np.float32,
    early_stop: float | None = None,
    repaint: Repaint | None = None,
    threads: int | None = None,
) -> Frame:
    """Draws a picture in `dtype`, float32 or float64, and keeps what `differentiate` needs.

    `depth_order` serves further frames where the settings' `resort_frames` allow it; without it each frame is
    sorted. A picture with `edits`, or over more than a colour, has no gradients. `nonzero`: the scene's SH
    bands that are not zero, where that is known; no picture depends on it. `background` (3,) replaces that
    of the settings. `early_stop`: transmittance below which a pixel is terminated. `repaint`: as in
    `frame.arrange`.

    Raises:
        ValueError: an argument cannot be used; the message names it.
    """
    if threads is not None and not threads >= 1:
        raise ValueError(f"threads must be at least 1, got {threads}")
    if early_stop is None:
        early_stop = EARLY_STOP if settings.early_stop is None else settings.early_stop
    if not 0 <= early_stop < 1:
        raise ValueError(f"early_stop must be in [0, 1), got {early_stop}")
    if np.dtype(dtype) not in (np.dtype(np.float32), np.dtype(np.float64)):
        raise ValueError(f"dtype must be float32 or float64, got {np.dtype(dtype)}")
    # Any background but a colour is composited afterwards: the kernels know nothing of it.
    plain = background is not None or isinstance(settings.background, tuple)
    if background is None:
        background = np.array(settings.background if plain else (0.0, 0.0, 0.0))
    colour = np.array(background, dtype)
    if colour.shape != (3,) or not np.isfinite(colour).all():
        raise ValueError(f"background must be 3 finite numbers, got {colour}")
    if settings.order not in ORDERS:
        raise ValueError(f"order must be one of {', '.join(ORDERS)} on the CPU, got {settings.order}")
    view = make_view(camera, settings, np.dtype(dtype))
    threads = threads or available_threads()
    edited = edit_arrays(edits, len(splats.means))
    key_bits = 16 if settings.order == "16-bit" else 32
    slopes_of = order_of = None
    if settings.order == "per-pixel":
        slopes_of = partial(depth_slopes, splats, camera=camera, settings=settings, edits=edited)
    if depth_order is not None and keeps_order(settings):
        order_of = partial(
            depth_order.visible_order, splats, camera, settings, view, workspace, edited, key_bits, threads
        )
    frame = draw(
        splats,
        view,
        colour,
        workspace,
        sh_degree=used_degree(splats, settings),
        early_stop=early_stop,
        optics=make_optics(camera),
        surfels=make_surfels(camera, settings.model),
        edits=edited,
        nonzero=nonzero,
        key_bits=key_bits,
        order_of=order_of,
        slopes_of=slopes_of,
        repaint=repaint,
        threads=threads,
    )
    if not plain:
        composite_over(frame.image, settings.background, camera)
    return frame
