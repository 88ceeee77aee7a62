"""Depth order on the CPU in a thread of its own: the latest view wins, and nobody waits who need not."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field

import numpy as np

from splatview.raster import Workspace
from splatview.raster.sort import keyed_values, radix_sort
from splatview.scene import Camera
from splatview.scene.edits import PALETTE_SHIFT, SceneEdits

SLICE = 65_536
"""Means converted to float64 at once, so that the copy stays in the caches."""

KEY_BITS = 32


@dataclass(frozen=True)
class ViewLine:
    """What decides the order: where the camera is, where it looks, and edits that move splats. Equal lines,
    equal orders."""

    eye: tuple[float, ...]
    forward: tuple[float, ...]
    places: object = None
    """Differs where edits put the splats elsewhere; None: they are where the scene has them."""
    edits: SceneEdits | None = field(default=None, compare=False)
    """What puts them there."""

    @classmethod
    def of(cls, camera: Camera, edits: SceneEdits | None = None, places: object = None) -> ViewLine:
        return cls(tuple(camera.eye.tolist()), tuple(camera.forward.tolist()), places, edits)

    def depths(self, means: np.ndarray, part: slice) -> np.ndarray:
        """Of splats `part` at `means` (N, 3), edited: float64."""
        eye, forward = np.array(self.eye), np.array(self.forward)
        if self.edits is None:
            return (means[part] - eye) @ forward
        palette = self.edits.palette
        along = np.array([forward @ adjustment.linear for adjustment in palette])
        before = np.array([forward @ (np.array(adjustment.translation) - eye) for adjustment in palette])
        # The editor may write newer marks meanwhile: then this order is soon replaced by another.
        entries = np.minimum(self.edits.marks[part] >> PALETTE_SHIFT, len(palette) - 1)
        return np.einsum("ni,ni->n", means[part], along[entries]) + before[entries]


@dataclass(frozen=True, eq=False, kw_only=True)
class DepthOrder:
    """All splats of a scene, nearest first."""

    view: ViewLine
    order: np.ndarray
    """(N,) int32: those before the eye by depth, then those behind it, then those without a depth."""
    before_eye: int
    """How many are before the eye: for this very view the others need not be drawn."""
    milliseconds: float
    """What it took."""


def depth_order(means: np.ndarray, view: ViewLine, workspace: Workspace) -> DepthOrder:
    """Orders splats at `means` (N, 3) by float32 depth, ties by index."""
    began = time.perf_counter()
    depths = np.empty(len(means), np.float32)
    with np.errstate(invalid="ignore", over="ignore"):
        for start in range(0, len(means), SLICE):
            part = slice(start, start + SLICE)
            depths[part] = view.depths(means, part)
    # Bits of floats from 0 up rise with the float; a set sign bit puts all behind the eye after them.
    keys = depths.view(np.uint32)
    before_eye = int(np.count_nonzero(depths >= 0))
    keyed = keyed_values(keys, np.arange(len(means)))
    order = radix_sort(keyed, KEY_BITS, 1, workspace)
    return DepthOrder(
        view=view,
        order=order.copy(),  # the workspace is used again
        before_eye=before_eye,
        milliseconds=(time.perf_counter() - began) * 1000,
    )


class SortWorker:
    """Sorts one scene's splats for whichever view was asked for last.

    An error in the thread is raised by the next call that would have given its result.
    """

    def __init__(self, means: np.ndarray) -> None:
        self._means = means
        self._change = threading.Condition()
        # Guarded by _change:
        self._wanted: ViewLine | None = None
        self._newest: DepthOrder | None = None
        self._error: Exception | None = None
        self._ended = False
        self._thread = threading.Thread(target=self._work, name="splatview-sort", daemon=True)
        self._thread.start()

    def request(self, view: ViewLine) -> None:
        """Asks for the order of `view` instead of what was asked for before; returns at once."""
        with self._change:
            if view != self._wanted:
                self._wanted = view
                self._change.notify_all()

    def newest(self) -> DepthOrder | None:
        """The last order finished, of an earlier view perhaps; None before the first."""
        with self._change:
            self._raise_error()
            return self._newest

    def wait(self) -> DepthOrder:
        """The order of the view asked for last, which must be asked for before."""
        with self._change:
            self._change.wait_for(lambda: self._error or self._is_done())
            self._raise_error()
            if self._newest is None:
                raise RuntimeError("no order was asked for")
            return self._newest

    @property
    def busy(self) -> bool:
        """Whether the order of the view asked for last is still to come."""
        with self._change:
            return not self._is_done()

    def release(self) -> None:
        """Ends the thread, after the order it is at."""
        with self._change:
            self._ended = True
            self._change.notify_all()
        self._thread.join()

    def _is_done(self) -> bool:
        return self._wanted is None or (self._newest is not None and self._newest.view == self._wanted)

    def _raise_error(self) -> None:
        if self._error is not None:
            raise RuntimeError("sorting in the background failed") from self._error

    def _work(self) -> None:
        workspace = Workspace()
        while True:
            with self._change:
                self._change.wait_for(lambda: self._ended or not self._is_done())
                if self._ended:
                    return
                view = self._wanted
            assert view is not None  # else _is_done
            try:
                result = depth_order(self._means, view, workspace)
            except Exception as error:  # handed to the GL thread: a thread has nobody to raise to
                with self._change:
                    self._error = error
                    self._change.notify_all()
                return
            with self._change:
                self._newest = result
                self._change.notify_all()
