"""Pictures and edits in one call, for scripts and notebooks."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from splatview.edit.document import Document, exported
from splatview.edit.operations.base import Operation
from splatview.edit.recipe import Recipe, check_scene, load_recipe, replay, steps_from_json
from splatview.renderers.cpu import CpuRenderer
from splatview.renderers.headless import make_headless
from splatview.renderers.modes import VisualMode
from splatview.renderers.request import FrameRequest, Renderer
from splatview.scene import Camera, Gaussians, InputError, RenderSettings
from splatview.scene.effects.overrides import settings_for
from splatview.scene.progress import NO_PROGRESS, Progress

Steps = Recipe | str | os.PathLike[str] | Sequence[Operation | Mapping[str, Any]]


def render(
    gaussians: Gaussians,
    camera: Camera,
    settings: RenderSettings | None = None,
    *,
    mode: VisualMode = "splats",
    renderer: Renderer | str = "auto",
) -> np.ndarray:
    """The picture (H, W, 4) float32 of a scene: RGB over the background, display-referred, and alpha.

    `settings`: None takes what the scene calls for, over black. `renderer`: a name as `--renderer` takes it,
    or one from `make_headless`, which keeps the scene loaded and is the faster for many pictures.

    Raises:
        InputError: the renderer does not work here, or cannot draw this.
    """
    request = FrameRequest(
        gaussians, camera, settings_for(gaussians) if settings is None else settings, mode=mode
    )
    if not isinstance(renderer, str):
        return renderer.render(request).astype(np.float32, copy=False)
    made = make_headless(renderer, mode=mode, knobs={"order": request.settings.order})
    try:
        return made.render(request).astype(np.float32, copy=False)
    finally:
        made.close()


def apply_recipe(
    gaussians: Gaussians,
    recipe: Steps,
    *,
    any_scene: bool = False,
    on_split: Callable[[Gaussians, Path], object] | None = None,
    progress: Progress = NO_PROGRESS,
) -> Gaussians:
    """The scene after the steps of a recipe, as `splatview edit` writes it; `gaussians` stays as it is.

    `recipe`: a file, a `Recipe`, or its steps, each an operation or its JSON, as in docs/editing.md.
    `any_scene`: also a recipe that was made for another scene. `on_split` is given what a step splits off,
    and the path that it names.

    Raises:
        InputError: the recipe is wrong or cannot be applied, with the step's number; nothing would be left;
            a step splits off and nobody takes it.
        Cancelled: nobody waits for it any more.
    """
    if isinstance(recipe, str | os.PathLike):
        recipe = load_recipe(recipe)
    elif not isinstance(recipe, Recipe):
        steps = (step.to_json() if isinstance(step, Operation) else step for step in recipe)
        recipe = Recipe(steps=steps_from_json(list(steps), "steps"), scene={})

    def refuse(scene: Gaussians, path: Path) -> None:
        raise InputError(f"splits {len(scene):,} splats off to {path}; give on_split, which takes them")

    document = Document(gaussians, folder=recipe.folder, tools=CpuRenderer(), save=on_split or refuse)
    check_scene(recipe, document, any_scene=any_scene)
    replay(recipe, document, progress=progress, undo=False)
    return exported(document)
