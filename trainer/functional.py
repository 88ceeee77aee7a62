"""Differentiable operations of training, as functions of torch over the CPU kernels, without copies."""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from splatview.raster import Frame, Parameters, Workspace, available_threads, draw_frame
from splatview.raster.compiling import TASKS_PER_THREAD, even_ranges, run
from splatview.raster.frame import StageClock
from splatview.raster.gradients import Gradients, differentiate
from splatview.raster.parameters import check_parameters
from splatview.raster.project import RX, RY
from splatview.raster.sort import UNSHARED
from splatview.scene import Camera, RenderSettings
from splatview.scene.sh import SH_C0
from splatview.trainer.loss import SSIM_WEIGHT
from splatview.trainer.loss import photo_loss as compare
from splatview.trainer.loss_kernels import expose_backward_rows, expose_rows, shade_backward_rows, shade_rows

GRADIENT_EARLY_STOP = 1e-7
"""The light below which a pixel ends, in float32. Where gradients nearly cancel, what they leave out at
`raster.EARLY_STOP` shows in their fourth digit; at this, in their sixth, for a twentieth more time."""


class Visibility:
    """What density control asks of a picture: which splats show, how large, and how hard each is pulled."""

    def __init__(self, pieces: list[np.ndarray], count: int, size: tuple[int, int] = (0, 0)) -> None:
        """`pieces`: int32 arrays of distinct indices; `size`: the picture's width and height."""
        self.pieces = pieces
        """Splats that reach into the image, ascending: parts that may be worked on apart."""
        self.count = count
        """N, the splats of the scene."""
        self.width, self.height = size
        self.means2d: torch.Tensor | None = None
        """(N, 2) dL/d(mean in the image), px; None before backward, and where nobody asked for it."""
        self.abs_means2d: torch.Tensor | None = None
        """(N, 2) the same, added up over pixels by absolute value (Ye et al. 2024, AbsGS)."""
        self.milliseconds: dict[str, float] = {}
        """Time in the rasteriser by stage, so far."""
        self._on_backward: list[Callable[[Visibility], None]] = []
        self._frame: Callable[[], Frame | None] = lambda: None

    def __len__(self) -> int:
        return sum(map(len, self.pieces))

    @property
    def indices(self) -> torch.Tensor:
        """(V,) int64, ascending: splats that reach into the image."""
        return torch.from_numpy(np.concatenate(self.pieces).astype(np.int64))

    @property
    def visible(self) -> torch.Tensor:
        """(N,) bool."""
        mask = torch.zeros(self.count, dtype=torch.bool)
        mask[self.indices] = True
        return mask

    @property
    def radii(self) -> torch.Tensor:
        """(V,) px: the larger half extent of the ellipse where alpha is at least the cut.

        Raises:
            RuntimeError: the picture has been differentiated, or dropped, and its numbers are gone.
        """
        frame = self._frame()
        if frame is None:
            raise RuntimeError("ask for radii before the picture is differentiated")
        indices = np.concatenate(self.pieces)
        return torch.from_numpy(np.maximum(frame.records[indices, RX], frame.records[indices, RY]))

    def include(self, other: Visibility) -> None:
        """Counts what another picture of the same splats shows as shown by this one."""
        mask = self.visible
        before = int(mask.sum())
        mask[other.indices] = True
        if int(mask.sum()) > before:
            union = np.flatnonzero(mask.numpy()).astype(np.int32)
            self.pieces = np.array_split(union, max(len(self.pieces), 1))

    def on_backward(self, function: Callable[[Visibility], None]) -> None:
        """Has `function` called with this once the picture has been differentiated."""
        self._on_backward.append(function)


def rasterize(
    means: torch.Tensor,
    quats: torch.Tensor,
    log_scales: torch.Tensor,
    opacity_logits: torch.Tensor,
    sh: torch.Tensor,
    camera: Camera,
    settings: RenderSettings | None = None,
    *,
    background: torch.Tensor | None = None,
    pose: torch.Tensor | None = None,
    early_stop: float | None = None,
    dtype: torch.dtype | None = None,
    by_view: bool = True,
    threads: int | None = None,
) -> tuple[torch.Tensor, Visibility]:
    """The picture (H, W, 4), RGB over the background and alpha, in `dtype`; and what shows in it.

    Parameters have the shapes of `scene.Gaussians` and are all float32 or all float64, on the CPU; `dtype`
    is theirs where it is None. `background` (3,) stands for that of the settings and may need a gradient.
    `pose` (6,) must be zeros; its gradient is that of a small motion of the camera, (shift, turn) in camera
    axes: see `raster.gradients`. `early_stop` is the light below which a pixel ends; by default that of
    the settings, or else `GRADIENT_EARLY_STOP` in float32 and 0, never, in float64. Threads: None means all
    cores.

    The gradients by the means in the image are in the `Visibility` once the picture has been differentiated,
    unless `by_view` is false, which leaves out what they cost; a pose that needs a gradient gets it anyway.
    A picture that is differentiated again (`retain_graph`) is drawn again first. There are no second
    derivatives.

    Raises:
        ValueError: an argument has the wrong shape, dtype or device; the message names it.
    """
    settings = settings or RenderSettings()
    named = {
        "means": means,
        "quats": quats,
        "log_scales": log_scales,
        "opacity_logits": opacity_logits,
        "sh": sh,
    }
    if not isinstance(means, torch.Tensor):
        raise ValueError(f"means must be a tensor, got {type(means).__name__}")
    if means.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"means must be torch.float32 or torch.float64, got {means.dtype}")
    for name, tensor in named.items():
        _check(name, tensor, means.dtype)
    dtype = dtype or means.dtype
    for name, tensor, length in (("background", background, 3), ("pose", pose, 6)):
        if tensor is not None:
            _check(name, tensor, dtype)
            if tensor.shape != (length,):
                raise ValueError(f"{name} must have shape ({length},), got {tuple(tensor.shape)}")
    if pose is not None and not (pose.detach() == 0).all():
        raise ValueError("pose must be zeros: move the camera instead")
    if early_stop is None:
        early_stop = settings.early_stop
    if early_stop is None:
        early_stop = GRADIENT_EARLY_STOP if dtype == torch.float32 else 0.0
    visibility = Visibility([], len(means), (camera.width, camera.height))
    options = _Options(camera, settings, early_stop, NUMPY[dtype], by_view, threads)
    image = _Rasterize.apply(*named.values(), background, pose, options, visibility)
    assert isinstance(image, torch.Tensor)
    return image, visibility


NUMPY = {torch.float32: np.float32, torch.float64: np.float64}


def _check(name: str, tensor: Any, dtype: torch.dtype) -> None:
    if not isinstance(tensor, torch.Tensor):
        raise ValueError(f"{name} must be a tensor, got {type(tensor).__name__}")
    if tensor.device.type != "cpu":
        raise ValueError(f"{name} must be on the CPU, got {tensor.device}")
    if tensor.dtype != dtype:
        raise ValueError(f"{name} must be {dtype} like means, got {tensor.dtype}")


@dataclass(frozen=True, eq=False)
class _Options:
    """How a picture is drawn."""

    camera: Camera
    settings: RenderSettings
    early_stop: float
    dtype: type[np.floating]
    by_view: bool
    threads: int | None

    def draw(self, splats: Parameters, background: torch.Tensor | None, workspace: Workspace) -> Frame:
        return draw_frame(
            splats,
            self.camera,
            self.settings,
            workspace,
            background=None if background is None else background.detach().numpy(),
            dtype=self.dtype,
            early_stop=self.early_stop,
            threads=self.threads,
        )


@dataclass(eq=False)
class _Buffers:
    """Memory of pictures: fresh memory costs a page fault every 4 KiB, in a step of 200,000 splats a tenth of
    its time for gradients alone."""

    workspace: Workspace = field(default_factory=Workspace)
    gradients: list[np.ndarray] = field(default_factory=list)
    """Arrays of the latest gradients, which the graph that they went into may still hold."""

    def differentiate(
        self, splats: Parameters, frame: Frame, d_image: np.ndarray, *, by_view: bool
    ) -> Gradients:
        """Overwrites the latest gradients where nothing but this refers to them any more."""
        arrays, reuse = self.gradients, None
        if arrays and all(sys.getrefcount(arrays[i]) <= UNSHARED for i in range(len(arrays))):
            means2d, abs_means2d = arrays[5:] or (None, None)
            reuse = Gradients(
                parameters=Parameters(*arrays[:5]),
                means2d=means2d,
                abs_means2d=abs_means2d,
                background=np.empty(0),
                pose=None,
                milliseconds={},
            )
        found = differentiate(splats, frame, d_image, by_view=by_view, reuse=reuse)
        by_means = (found.means2d, found.abs_means2d)
        self.gradients = [*found.parameters, *(array for array in by_means if array is not None)]
        return found


class _Pool:
    """Buffers that no picture is using. A picture keeps its own from forward to backward."""

    def __init__(self) -> None:
        self._free: list[_Buffers] = []
        self._lock = threading.Lock()

    def take(self) -> _Buffers:
        with self._lock:
            return self._free.pop() if self._free else _Buffers()

    def give_back(self, buffers: _Buffers) -> None:
        with self._lock:
            self._free.append(buffers)


_pictures, _losses = _Pool(), _Pool()


class _Held:
    """Buffers in use, which go back when they are released or nobody wants them any more."""

    def __init__(self, pool: _Pool) -> None:
        self._pool = pool
        self.buffers: _Buffers | None = pool.take()

    def release(self) -> None:
        buffers, self.buffers = self.buffers, None
        if buffers is not None:
            self._pool.give_back(buffers)

    def __del__(self) -> None:
        self.release()


class _HeldFrame(_Held):
    """A frame in its buffers."""

    def __init__(self, options: _Options, splats: Parameters, background: torch.Tensor | None) -> None:
        super().__init__(_pictures)
        assert self.buffers is not None
        self.splats = splats
        self.frame: Frame | None = options.draw(splats, background, self.buffers.workspace)

    def release(self) -> None:
        self.frame = None
        super().release()


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *args: Any) -> torch.Tensor:
        *tensors, background, _pose, options, visibility = args
        splats = check_parameters(*(tensor.detach().numpy() for tensor in tensors))
        held = _HeldFrame(options, splats, background)
        frame = held.frame
        assert frame is not None
        # Copies, as the workspace's next picture overwrites them.
        visibility.pieces = [frame.visible[start:stop].copy() for start, stop in frame.runs]
        visibility.milliseconds |= frame.milliseconds
        visibility._frame = lambda: held.frame
        ctx.held, ctx.options, ctx.visibility, ctx.background = held, options, visibility, background
        # Autograd notices through these if a parameter is changed in place before backward reads it.
        ctx.save_for_backward(*tensors)
        return torch.from_numpy(frame.image)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Any) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        _ = ctx.saved_tensors
        held: _HeldFrame = ctx.held
        if held.frame is None:  # the graph was kept after an earlier backward
            held = _HeldFrame(ctx.options, held.splats, ctx.background)
        frame, buffers = held.frame, held.buffers
        assert frame is not None and buffers is not None
        d_image = grad_outputs[0].contiguous().numpy()
        by_view = ctx.options.by_view or ctx.needs_input_grad[6]
        gradients = buffers.differentiate(held.splats, frame, d_image, by_view=by_view)
        visibility: Visibility = ctx.visibility
        visibility.milliseconds |= gradients.milliseconds
        if gradients.means2d is not None and gradients.abs_means2d is not None:
            visibility.means2d = torch.from_numpy(gradients.means2d)
            visibility.abs_means2d = torch.from_numpy(gradients.abs_means2d)
        held.release()
        clock = StageClock()
        with clock.stage("density"):
            for function in visibility._on_backward:
                function(visibility)
        visibility.milliseconds |= clock.milliseconds
        d_background = d_pose = None
        if ctx.needs_input_grad[5]:
            d_background = torch.from_numpy(gradients.background)
        if ctx.needs_input_grad[6] and gradients.pose is not None:
            d_pose = torch.from_numpy(gradients.pose.astype(d_image.dtype))
        return *map(torch.from_numpy, gradients.parameters), d_background, d_pose, None, None


LEAST_ALPHA = 1e-4
"""Where less than this covers a pixel, its depth fades to 0: a share of nothing is no depth."""


def rasterize_depth(
    means: torch.Tensor,
    quats: torch.Tensor,
    log_scales: torch.Tensor,
    opacity_logits: torch.Tensor,
    camera: Camera,
    settings: RenderSettings | None = None,
    *,
    threads: int | None = None,
) -> torch.Tensor:
    """Expected depth (H, W) in world units along the view axis, 0 where nothing is: the mean of the camera
    depths of the splats' centres, weighted as their colours are.

    Differentiable by all arguments, by drawing depths as colours. Arguments are those of `rasterize`.
    """
    return depth_and_visibility(means, quats, log_scales, opacity_logits, camera, settings, threads=threads)[
        0
    ]


def depth_and_visibility(
    means: torch.Tensor,
    quats: torch.Tensor,
    log_scales: torch.Tensor,
    opacity_logits: torch.Tensor,
    camera: Camera,
    settings: RenderSettings | None = None,
    *,
    threads: int | None = None,
) -> tuple[torch.Tensor, Visibility]:
    """`rasterize_depth`, and what shows in it."""
    axis = torch.tensor(camera.R_camera_world[2], dtype=means.dtype)
    eye = torch.tensor(camera.eye, dtype=means.dtype)
    depths = (means - eye) @ axis
    # A colour is 0.5 + SH_C0·sh, and nothing behind the eye is drawn.
    sh = ((depths - 0.5) / SH_C0)[:, None, None].expand(-1, 1, 3)
    black = replace(settings or RenderSettings(), background=(0.0, 0.0, 0.0))
    picture, info = rasterize(means, quats, log_scales, opacity_logits, sh, camera, black, threads=threads)
    return picture[..., 0] / picture[..., 3].clamp_min(LEAST_ALPHA), info


def photo_loss(
    image: torch.Tensor,
    photo: torch.Tensor,
    *,
    mask: torch.Tensor | None = None,
    alpha: torch.Tensor | None = None,
    alpha_known: int = 255,
    ssim_weight: float = SSIM_WEIGHT,
    alpha_weight: float = 0.0,
    threads: int | None = None,
) -> torch.Tensor:
    """(1 - w)·L1 + w·(1 - SSIM) of a picture (H, W, 4), float32 or float64, and a photo (H, W, 3) uint8.

    All on the CPU; mask (H, W) bool: pixels that are false count as equal. With w = 1 it is 1 - SSIM.
    alpha (H, W) uint8 is the photo's opacity: `alpha_weight` times the mean difference of the picture's from
    it is added, where that opacity is not above `alpha_known`.

    Raises:
        ValueError: a tensor has the wrong shape or dtype; see `loss.photo_loss`.
    """
    loss = _PhotoLoss.apply(image, photo, mask, alpha, alpha_known, ssim_weight, alpha_weight, threads)
    assert isinstance(loss, torch.Tensor)
    return loss


class _PhotoLoss(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *args: Any) -> torch.Tensor:
        image, photo, mask, alpha, alpha_known, ssim_weight, alpha_weight, threads = args
        held = _Held(_losses)
        assert held.buffers is not None
        workspace = held.buffers.workspace

        def compared(image: torch.Tensor) -> Any:
            return compare(
                image.detach().contiguous().numpy(),
                photo.contiguous().numpy(),
                workspace,
                mask=None if mask is None else mask.contiguous().numpy(),
                alpha=None if alpha is None else alpha.contiguous().numpy(),
                alpha_known=alpha_known,
                ssim_weight=ssim_weight,
                alpha_weight=alpha_weight,
                threads=threads,
            )

        result = compared(image)
        # The gradient lives in the buffers: they are the graph's until it is gone.
        ctx.held, ctx.compared, ctx.d_image = held, compared, result.d_image
        ctx.save_for_backward(image)
        return torch.tensor(result.loss, dtype=image.dtype)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Any) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        (image,) = ctx.saved_tensors
        d_image, ctx.d_image = ctx.d_image, None
        if d_image is None:  # given away in an earlier backward, and autograd may have added to it
            d_image = ctx.compared(image).d_image
        by_image = torch.from_numpy(d_image)
        if grad_outputs[0] != 1:
            by_image = by_image * grad_outputs[0]
        return by_image, None, None, None, None, None, None, None


def expose(
    image: torch.Tensor,
    exposure: torch.Tensor,
    background: tuple[float, float, float] | None = None,
    threads: int | None = None,
) -> torch.Tensor:
    """The picture (H, W, 4) as a photo of another exposure shows it: gain·colour + offset, alpha as it is.

    `exposure` (3, 2) float64: logarithm of the gain, and offset, of each colour. `background`: colour behind
    a cut-out, RGB, which was put there after the photo was taken and keeps its value; None: opaque photos.
    Gradients are equal for any number of threads (None: all cores).
    """
    exposed = _Expose.apply(image, exposure, background, threads)
    assert isinstance(exposed, torch.Tensor)
    return exposed


class _Expose(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *args: Any) -> torch.Tensor:
        image, exposure, background, threads = args
        shown, (log_gain, offset) = image.detach().numpy(), exposure.detach().numpy().T
        values = (np.exp(log_gain), offset, np.zeros(3) if background is None else np.array(background))
        ctx.model = (*(value.astype(shown.dtype) for value in values), background is not None)
        ctx.threads = threads or available_threads()
        ctx.tasks = even_ranges(len(shown), TASKS_PER_THREAD * ctx.threads)
        exposed = np.empty_like(shown)
        run(expose_rows, ctx.tasks, (shown, *ctx.model, exposed), ctx.threads)
        ctx.save_for_backward(image)
        return torch.from_numpy(exposed)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Any) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        (image,) = ctx.saved_tensors
        shown, d_exposed = image.detach().numpy(), grad_outputs[0].contiguous().numpy()
        d_image, sums = np.empty_like(shown), np.empty((len(shown), 3, 2))
        run(expose_backward_rows, ctx.tasks, (shown, d_exposed, *ctx.model, d_image, sums), ctx.threads)
        return torch.from_numpy(d_image), torch.from_numpy(sums.sum(axis=0)), None, None


@lru_cache(maxsize=16)
def weights(length: int, nodes: int) -> np.ndarray:
    """(length, nodes) float32: of the nodes of a map in the middles of so many pixels, linear in between."""
    places = (np.arange(length) + 0.5) / length * (nodes - 1)
    rows = [np.interp(places, np.arange(nodes), node) for node in np.eye(nodes)]
    return np.stack(rows, axis=1).astype(np.float32)


@lru_cache(maxsize=16)
def left_nodes(length: int, nodes: int) -> np.ndarray:
    """(length,) int64: the first of the two nodes that `weights` has for a pixel."""
    places = (np.arange(length) + 0.5) / length * (nodes - 1)
    return np.minimum(places.astype(np.int64), nodes - 2)


def shade(image: torch.Tensor, log_gains: torch.Tensor, threads: int | None = None) -> torch.Tensor:
    """The picture (H, W, 4) as a photo shows it whose map is log_gains (N, M); alpha as it is.

    Nodes are N down and M across, see `shading`, those at the ends at the photo's borders.

    Between nodes gains are linear. Gradients are equal for any number of threads (None: all cores).
    """
    shaded = _Shade.apply(image, torch.exp(log_gains), threads)
    assert isinstance(shaded, torch.Tensor)
    return shaded


class _Shade(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *args: Any) -> torch.Tensor:
        image, gains, threads = args
        shown = image.detach().numpy()
        sizes = zip(shown.shape[:2], gains.shape, strict=True)
        ctx.rows, columns = (weights(length, nodes).astype(shown.dtype) for length, nodes in sizes)
        # What is as large as the picture is left to kernels: the threads of a product by BLAS wait in loops
        # on the cores that the next kernels need, and steps took up to 1.8 times as long (shading_cost.json).
        gains_of_rows = ctx.rows @ gains.detach().numpy().astype(shown.dtype)
        ctx.gains = gains_of_rows, columns, left_nodes(shown.shape[1], gains.shape[1])
        ctx.threads = threads or available_threads()
        ctx.tasks = even_ranges(len(shown), TASKS_PER_THREAD * ctx.threads)
        shaded = np.empty_like(shown)
        run(shade_rows, ctx.tasks, (shown, *ctx.gains, shaded), ctx.threads)
        ctx.save_for_backward(image)
        return torch.from_numpy(shaded)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Any) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        (image,) = ctx.saved_tensors
        shown, d_shaded = image.detach().numpy(), grad_outputs[0].contiguous().numpy()
        d_image, by_gain = np.empty_like(shown), np.empty_like(ctx.gains[0])
        run(shade_backward_rows, ctx.tasks, (shown, d_shaded, *ctx.gains, d_image, by_gain), ctx.threads)
        by_node = ctx.rows.T.astype(np.float64) @ by_gain
        return torch.from_numpy(d_image), torch.from_numpy(by_node), None


def followed(values: np.ndarray, gradients: np.ndarray) -> torch.Tensor:
    """Values as a tensor in their memory, whose gradients are added to `gradients`, of their shape."""

    def add(gradient: torch.Tensor) -> None:
        gradients[...] += gradient.numpy()

    tensor = torch.from_numpy(values).requires_grad_()
    tensor.register_hook(add)
    return tensor


GONE = -30.0
"""Logit whose opacity no picture shows."""


def dropout(opacity_logits: torch.Tensor, share: float, rng: np.random.Generator) -> torch.Tensor:
    """Logits (N,) of the splats with this share (below 1) of them, drawn by chance, made invisible; the rest
    is stronger.

    A step without some of the splats keeps the others from relying on them: where photos are few, splats that
    make one photo right by covering for one another's faults make every other view wrong. Source: Park et al.
    2025, DropGaussian. There the opacities of those left are divided by their share; here their logits are
    raised by its logarithm, which is the same where splats are faint, keeps opacities below 1, and leaves the
    derivative by a logit as it is.
    """
    dropped = torch.from_numpy(rng.random(len(opacity_logits), np.float32) < share)
    return (opacity_logits - math.log1p(-share)).masked_fill(dropped, GONE)
