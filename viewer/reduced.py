"""Scenes as shortcuts reduce them: fewer splats, attributes in fewer bits; made once a scene and kept.

What is kept of a scene is decided by measured contribution: the share of the pictures' light that a splat
makes in views from all around (`edit.sample_views`), whatever view is drawn in the end. Smaller shares are
subsets of larger ones.
"""

from __future__ import annotations

import threading
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from ..measure.knobs import Plan
from ..scene import Gaussians
from ..scene.edits import HIDDEN, SceneEdits
from ..scene.effects import settings_for
from ..scene.stored import Attributes, stored


class Reduced:
    """The reduced forms of one scene, made when first asked for."""

    def __init__(self) -> None:
        self._ranking: np.ndarray | None = None
        self._being_ranked = threading.Lock()
        self._forms: dict[tuple[float, Attributes], Gaussians] = {}

    def form(self, gaussians: Gaussians, kept: float, attributes: Attributes) -> Gaussians:
        key = kept, attributes
        if key not in self._forms:
            fewer = gaussians if kept >= 1 else gaussians.take(self.most_seen(gaussians, kept))
            self._forms[key] = stored(fewer, attributes)
        return self._forms[key]

    def most_seen(self, gaussians: Gaussians, share: float) -> np.ndarray:
        return np.sort(self.ranking(gaussians)[: kept_count(len(gaussians), share)])

    def ranking(self, gaussians: Gaussians) -> np.ndarray:
        """(N,) indices. From any thread; who comes while it is made waits for it."""
        with self._being_ranked:
            if self._ranking is None:
                self._ranking = ranked_by_contribution(gaussians)
            return self._ranking

    @property
    def is_ranked(self) -> bool:
        return self._ranking is not None


_reduced: WeakKeyDictionary[Gaussians, Reduced] = WeakKeyDictionary()


def reduced(gaussians: Gaussians, plan: Plan) -> Gaussians:
    """The scene that `plan` draws: `gaussians` itself where nothing is reduced, else a form of it that is the
    same object whenever it is asked for again."""
    if plan.kept >= 1 and plan.attributes == "float32":
        return gaussians
    return _reduced.setdefault(gaussians, Reduced()).form(gaussians, plan.kept, plan.attributes)


def is_ranked(gaussians: Gaussians) -> bool:
    """Whether it is known what a share keeps: finding out takes a second for some 500,000 splats."""
    known = _reduced.get(gaussians)
    return known is not None and known.is_ranked


def rank(gaussians: Gaussians) -> None:
    """Finds it out. For a thread of its own."""
    _reduced.setdefault(gaussians, Reduced()).ranking(gaussians)


def with_rest_hidden(gaussians: Gaussians, kept: float, edits: SceneEdits | None) -> SceneEdits | None:
    """`edits` that hide what a share `kept` of the splats leaves out besides: what is loaded can stay."""
    if kept >= 1:
        return edits
    chosen = _reduced.setdefault(gaussians, Reduced()).most_seen(gaussians, kept)
    rest = np.ones(len(gaussians), bool)
    rest[chosen] = False
    made = edits or SceneEdits(marks=np.zeros(len(gaussians), np.uint32))
    marks = made.marks.copy()
    marks[rest] |= HIDDEN
    return replace(made, marks=marks, flags=made.flags | HIDDEN, changes=())


def kept_count(splats: int, share: float) -> int:
    """How many of `splats` a share is: one at least, if there are any."""
    return min(splats, max(1, round(splats * share)))


def ranked_by_contribution(gaussians: Gaussians) -> np.ndarray:
    """(N,) indices, the splats that make most of the pictures first; of equals the earlier one."""
    # Imported when needed: they compile.
    from .. import raster
    from ..edit.sample_views import sample_cameras

    if not len(gaussians):
        return np.zeros(0, np.intp)
    cameras = sample_cameras(gaussians, SceneEdits(marks=np.zeros(len(gaussians), np.uint32)))
    worth = raster.contributions(gaussians, cameras, settings_for(gaussians))
    return np.argsort(-np.nan_to_num(worth, nan=0.0), kind="stable")
