"""A loss of one's own: a function of a step that returns a scalar of torch, from a file or from Python.

    def loss(step):
        opacity = step.splats.opacity_logits.sigmoid()
        return step.photo_loss + 0.01 * (opacity * (1 - opacity)).mean()

What it returns is the loss of the step; `step.photo_loss` is the usual one, and a function that does not read
it replaces it. Whatever is wrong with the function is one line that names it and the step, and the step has
not happened.
"""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import traceback
from collections.abc import Callable
from functools import cached_property
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import torch

from splatview.scene import Camera, RenderSettings
from splatview.scene.formats.io import require_regular_file
from splatview.trainer.counters import PluginError
from splatview.trainer.functional import Visibility, depth_and_visibility

FUNCTION = "loss"
"""Name of the function in a file."""


class SplatTensors(NamedTuple):
    """The parameters of a scene in training, float32, in the shapes of `scene.Gaussians`."""

    means: torch.Tensor
    quats: torch.Tensor
    log_scales: torch.Tensor
    opacity_logits: torch.Tensor
    sh: torch.Tensor


class LossStep:
    """What a loss is a function of: one photo's step."""

    def __init__(
        self,
        *,
        image: torch.Tensor,
        photo: torch.Tensor,
        mask: torch.Tensor | None,
        camera: Camera,
        splats: SplatTensors,
        iteration: int,
        progress: float,
        settings: RenderSettings,
        photo_loss: Callable[[], torch.Tensor],
        threads: int,
        check: Callable[[str], Callable[[torch.Tensor], None]],
    ) -> None:
        self.photo = photo
        """(H, W, 3) uint8: the photo in the size that this step trains in."""
        self.mask = mask
        """(H, W) bool, false where the photo is not to be trained; None: trained everywhere."""
        self.camera = camera
        """The camera that took the photo, in that size."""
        self.iteration = iteration
        """Number of this step, from 1."""
        self.progress = progress
        """Share of the run that is over, 0 to 1."""
        self.settings = settings
        """Settings that pictures are drawn with."""
        self.used_photo_loss = False
        """Whether `photo_loss` has been read."""
        self.depth_visibility: Visibility | None = None
        """What the picture of `depth` shows, where it has been asked for."""
        self._image, self._splats, self._photo_loss = image, splats, photo_loss
        self._threads, self._check = threads, check

    @cached_property
    def image(self) -> torch.Tensor:
        """(H, W, 4) float32: what the scene shows, RGB and alpha, at the photo's exposure and in its light
        where these are learnt. Not clipped."""
        # A view of its own, so that what this loss makes of the gradient is told from what the photo does.
        image = self._image.view_as(self._image)
        image.register_hook(self._check("the picture"))
        return image

    @cached_property
    def splats(self) -> SplatTensors:
        """All splats. Only those that the photo shows, or `depth` if it is asked for, are moved in this step;
        what is split or cloned is decided by the photo alone."""
        views = SplatTensors(*(tensor.view_as(tensor) for tensor in self._splats))
        for name, view in views._asdict().items():
            view.register_hook(self._check(name))
        return views

    @property
    def photo_loss(self) -> torch.Tensor:
        """The usual loss of the step, a scalar: (1 - w)·L1 + w·(1 - SSIM)."""
        self.used_photo_loss = True
        return self._usual

    @cached_property
    def _usual(self) -> torch.Tensor:
        return self._photo_loss()

    def depth(self) -> torch.Tensor:
        """(H, W) float32: expected depth along the view axis in world units, 0 where nothing is. Drawn when
        it is asked for, which costs about as much as another picture."""
        return self._depth

    @cached_property
    def _depth(self) -> torch.Tensor:
        means, quats, log_scales, opacity_logits, _ = self.splats
        depth, self.depth_visibility = depth_and_visibility(
            means, quats, log_scales, opacity_logits, self.camera, self.settings, threads=self._threads
        )
        return depth


class LossPlugin:
    """A loss of the user's, whose every result is checked."""

    def __init__(self, function: Callable[[LossStep], torch.Tensor], *, file: str | None = None) -> None:
        """`file`: where it is from, None: where its code says."""
        self.function = function
        code = getattr(function, "__code__", None)
        self.file = file or getattr(code, "co_filename", None) or repr(function)
        self.digest = ""
        """SHA-256 of the file's bytes; "" for a function that was handed over."""
        self.replaces: bool | None = None
        """Whether it replaces the photo loss; None until a step has shown it."""

    @property
    def name(self) -> str:
        """Name of the file, without folders."""
        return Path(self.file).name

    def __call__(self, step: LossStep) -> torch.Tensor:
        """The loss of the step, finite, with a graph.

        Raises:
            PluginError: it is something else.
        """
        number = step.iteration
        try:
            value: Any = self.function(step)
        except (Exception, SystemExit) as error:
            raise PluginError(
                f"{self._place(error)}: {FUNCTION} failed at step {number}: {_told(error)}"
            ) from None
        if not isinstance(value, torch.Tensor):
            self._refuse(number, f"must return a scalar of torch, not {type(value).__name__}")
        if value.numel() != 1 or not value.is_floating_point():
            kind = str(value.dtype).removeprefix("torch.")
            self._refuse(number, f"must return a scalar, not {kind} of shape {tuple(value.shape)}")
        if not value.requires_grad:
            self._refuse(
                number,
                "returned a tensor without a graph, from which nothing can be learnt; compute it from"
                " step.image or step.splats, without detach() or numpy()",
            )
        # Where the photo loss itself is not finite, that is no fault of this one.
        if not torch.isfinite(value) and not (step.used_photo_loss and not torch.isfinite(step.photo_loss)):
            self._refuse(number, f"returned {value.item()}")
        self.replaces = not step.used_photo_loss
        return value.reshape(())

    def hooks(self, number: int) -> Callable[[str], Callable[[torch.Tensor], None]]:
        """Hooks, by what they are of, for gradients that this loss alone gives; they raise PluginError."""

        def hook_of(what: str) -> Callable[[torch.Tensor], None]:
            def hook(gradient: torch.Tensor) -> None:
                # The sum is finite where all are, in one pass; where it overflows, each is looked at.
                if not torch.isfinite(gradient.sum()) and not torch.isfinite(gradient).all():
                    self._refuse(number, f"has a gradient by {what} that is not finite")

            return hook

        return hook_of

    def backward(self, loss: torch.Tensor, number: int) -> None:
        """Differentiates what this returned. Raises PluginError where that cannot be done."""
        try:
            loss.backward()
        except PluginError:
            raise
        except (Exception, SystemExit) as error:
            where = self._place(error)
            raise PluginError(
                f"{where}: {FUNCTION} could not be differentiated at step {number}: {_told(error)}"
            ) from None

    def _refuse(self, number: int, what: str) -> NoReturn:
        raise PluginError(f"{self.file}: {FUNCTION} {what} (step {number})")

    def _place(self, error: BaseException) -> str:
        return place_of(error, self.file)


def place_of(error: BaseException, file: str) -> str:
    """`file:line` of the last line of `file` that an exception came through; `file` where it came through
    none."""
    lines = [one.lineno for one in traceback.extract_tb(error.__traceback__) if one.filename == file]
    if isinstance(error, SyntaxError) and error.filename == file:
        lines.append(error.lineno)
    return f"{file}:{lines[-1]}" if lines and lines[-1] else file


def _told(error: BaseException) -> str:
    text = error.msg if isinstance(error, SyntaxError) else " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def load_plugin(path: Path) -> LossPlugin:
    """The function `loss` of a Python file. Modules beside the file can be imported by it.

    Raises:
        PluginError: the file cannot be imported, or has no such function.
        InputError: there is no such file.
    """
    require_regular_file(path)
    file = str(path)
    name = f"splatview_plugin_{hashlib.sha256(file.encode()).hexdigest()[:8]}"
    spec = importlib.util.spec_from_file_location(name, file, loader=SourceFileLoader(name, file))
    if spec is None or spec.loader is None:
        raise PluginError(f"{file}: cannot be imported")
    folder = str(path.resolve().parent)
    if folder not in sys.path:
        sys.path.append(folder)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise PluginError(f"{place_of(error, file)}: cannot be imported: {_told(error)}") from None
    function: Any = getattr(module, FUNCTION, None)
    if not callable(function):
        raise PluginError(f"{file}: has no function {FUNCTION}(step); docs/training.md shows one")
    plugin = LossPlugin(function, file=file)  # pyright: ignore[reportArgumentType] checked as it is called
    plugin.digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return plugin
