"""What must hold at any moment, whatever a user has done."""

from __future__ import annotations

import ctypes
import gc
import hashlib
import statistics
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from splatview import raster
from splatview.edit.document import Document, Event, Step
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.edits import PREVIEW, SceneEdits, bake
from splatview.viewer.editing.session import session_of
from splatview.viewer.state import AppState, process_memory

PIXEL_BOUND = 4 / 255
"""Pictures may differ so much anywhere: float16 blending is within it."""

SHARE_BOUND = 2e-3
"""Of pixels that differ by more: where an alpha lies on the cut, or two depths tie, rounding decides."""

LEAST_OFF = 30
"""Pixels that may do so in any picture, however small."""

ALLOWED_MIB = 48.0
ALLOWED_SHARE = 0.06
"""How much the memory of a process may grow between the second and the last third of a soak, beyond what
scene and history hold: so many MiB, and such a share of what it had. Shader variants and kernels that are
first used late, and what allocators keep, are within it; a picture lost a second is not: at 800x500 px that
is 6 MiB."""

LEAST_LOOKS = 24
"""At the memory, before anything is concluded from it."""

BLOCK = 1 << 22


class Mishap(Exception):
    """Something that no user should meet."""


# ---- memory


@dataclass
class Memory:
    """Resident memory over time, and what of it the open scene accounts for."""

    seconds: list[float] = field(default_factory=list)
    resident: list[float] = field(default_factory=list)
    """MiB."""
    accounted: list[float] = field(default_factory=list)
    """MiB of scene and history."""

    def note(self, app: AppState, seconds: float) -> None:
        gc.collect()
        if sys.platform.startswith("linux"):
            # What is free but kept by the C library is no leak.
            ctypes.CDLL(None).malloc_trim(0)
        resident = process_memory()
        if resident is None:
            return
        known = 0
        if app.is_open:
            # As the file has it, as it is drawn, and as the picture holds it.
            known += 3 * app.scene.gaussians.nbytes
        if session := session_of(app):
            known += session.document.history.nbytes
        self.seconds.append(seconds)
        self.resident.append(resident)
        self.accounted.append(known / 2**20)

    @property
    def _rest(self) -> list[float]:
        return [a - b for a, b in zip(self.resident, self.accounted, strict=True)]

    @property
    def growth(self) -> float | None:
        """MiB, from the median of the second third to that of the last: the first one fills caches."""
        rest = self._rest
        third = len(rest) // 3
        if len(rest) < LEAST_LOOKS:
            return None
        return statistics.median(rest[-third:]) - statistics.median(rest[third : 2 * third])

    @property
    def allowed(self) -> float:
        rest = self._rest
        return ALLOWED_MIB + ALLOWED_SHARE * (statistics.median(rest) if rest else 0.0)

    def problems(self) -> list[str]:
        growth = self.growth
        if growth is None or not growth > self.allowed:
            return []
        return [f"memory grew by {growth:.0f} MiB, {self.allowed:.0f} are allowed"]

    def summary(self) -> dict[str, Any]:
        return {
            "end_mib": round(self.resident[-1], 1) if self.resident else 0.0,
            "most_mib": round(max(self.resident, default=0.0), 1),
            "growth_mib": None if self.growth is None else round(self.growth, 1),
            "allowed_mib": round(self.allowed, 1),
            "seconds": [round(value, 1) for value in self.seconds],
            "resident_mib": [round(value, 1) for value in self.resident],
            "accounted_mib": [round(value, 1) for value in self.accounted],
        }


# ---- threads


MOST_THREADS = {
    "splatview-train": 1,
    "splatview-cpu": 1,
    "splatview-cpu-plan": 1,
    "splatview-sort": 1,
    "splatview-compare": 1,
    "splatview-beside-photo": 1,
    "splatview-warm-up": 1,
    "splatview-precompile": 2,  # one for programs, one for kernels
}
"""Those that may live while nothing is under way; any other of ours must have ended."""

THREAD_SECONDS = 30.0
"""How long one whose work was cancelled may take to notice."""


def idle_threads() -> dict[str, int]:
    names = (thread.name.rstrip("0123456789").rstrip("_-") for thread in threading.enumerate())
    return dict(Counter(names))


def too_many_threads() -> str:
    """Those that should have ended, or ""."""
    now = idle_threads()
    extra = {
        name: count
        for name, count in now.items()
        if name.startswith("splatview-") and count > MOST_THREADS.get(name, 0)
    }
    return ", ".join(f"{count} x {name}" for name, count in extra.items())


def wait_for_threads(frame: Callable[[], object]) -> None:
    """`frame` lets the window go on: some wait for the thread that draws."""
    limit = time.monotonic() + THREAD_SECONDS
    while too_many_threads():
        if time.monotonic() > limit:
            raise Mishap(f"threads that should have ended: {too_many_threads()}")
        frame()


# ---- pictures


class Pictures:
    """Compares with what the CPU draws of the scene with its edits baked in."""

    def __init__(self, folder: Path):
        self.compared = 0
        self.largest_share_off = 0.0
        self._folder = folder

    def compare(
        self,
        what: str,
        picture: np.ndarray,
        gaussians: Gaussians,
        camera: Camera,
        settings: RenderSettings,
        edits: SceneEdits | None,
    ) -> None:
        """`picture` (H, W, 3 or 4) float. Raises Mishap."""
        baked = gaussians if edits is None else bake(gaussians, edits)
        truth = raster.render(baked, camera, replace(settings, order="32-bit"))[..., :3]
        picture = np.asarray(picture, np.float32)[..., :3]
        if not np.isfinite(picture).all():
            self._keep(picture, truth)
            raise Mishap(f"{what}: {np.count_nonzero(~np.isfinite(picture))} numbers are not finite")
        off = (np.abs(picture.clip(0, 1) - truth.clip(0, 1)) > PIXEL_BOUND).any(axis=-1)
        share = float(off.mean())
        self.compared += 1
        self.largest_share_off = max(self.largest_share_off, share)
        if share > SHARE_BOUND and np.count_nonzero(off) > LEAST_OFF:
            self._keep(picture, truth)
            raise Mishap(
                f"{what}: {share:.2%} of the pixels differ by more than 4/255 from the baked scene's"
            )

    def _keep(self, picture: np.ndarray, truth: np.ndarray) -> None:
        difference = 0.5 + 4 * (np.nan_to_num(picture) - truth)
        for name, image in (("picture", picture), ("truth", truth), ("difference", difference)):
            levels = (np.nan_to_num(image).clip(0, 1) * 255 + 0.5).astype(np.uint8)
            Image.fromarray(levels).save(self._folder / f"wrong-{name}.png")


# ---- edits


def digest(document: Document) -> bytes:
    """Of every byte that an edit can change; what is only lit up is left out."""
    found = hashlib.blake2b(digest_size=16)
    marks = document.marks
    for first in range(0, len(marks), BLOCK):
        found.update((marks[first : first + BLOCK] & ~np.uint32(PREVIEW)).tobytes())
    found.update(repr((document.palette, document.crops)).encode())
    scene = document.gaussians
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        found.update(np.ascontiguousarray(getattr(scene, name)).data)
    return found.digest()


class Undone:
    """Remembers every state of a document, and sees that undo and redo come back to it to the byte."""

    def __init__(self) -> None:
        self.checked = 0
        self.wrong: str | None = None
        self._document: Document | None = None
        self._states: list[bytes] = []

    def follow(self, document: Document | None) -> None:
        """From now on, if it is another one."""
        if document is self._document:
            return
        if self._document is not None and self._listen in self._document.listeners:
            self._document.listeners.remove(self._listen)
        self._document, self._states = document, []
        if document is not None:
            if document.history.position or document.previewed:
                self._document = None  # it has a past that was not seen
                return
            self._states = [digest(document)]
            document.listeners.append(self._listen)

    def _listen(self, event: Event, step: Step) -> None:
        document = self._document
        if document is None:
            return
        position = document.history.position
        if event == "apply":
            del self._states[position:]
            self._states.append(digest(document))
        elif event in ("undo", "redo"):
            self.checked += 1
            if digest(document) != self._states[position]:
                self.wrong = f"{event} of {step.title!r} did not come back to what was"


def same_scene(found: Gaussians, wanted: Gaussians) -> str:
    """In what two scenes differ, or "". NaN equals NaN."""
    if len(found) != len(wanted):
        return f"{len(found):,} splats instead of {len(wanted):,}"
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        a, b = getattr(found, name), getattr(wanted, name)
        if a.shape != b.shape or not np.array_equal(a, b, equal_nan=True):
            return name
    return ""
