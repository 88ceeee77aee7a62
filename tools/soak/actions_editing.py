"""What a user of the soak edits, undoes and writes to files."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from checks import Mishap, same_scene
from user import User

from splatview.edit.detectors import DETECTORS
from splatview.edit.operations import (
    AddCrop,
    ChangeCrop,
    ColourGrade,
    EnableCrop,
    Grow,
    Merge,
    Opacity,
    Operation,
    RemoveCrop,
    Select,
    Shrink,
    Size,
    Split,
    Transform,
    operation_from_json,
)
from splatview.edit.operations.appearance import Grade
from splatview.edit.selectors import Sphere
from splatview.scene import InputError
from splatview.scene.edits import Crop, bake
from splatview.scene.formats import load_scene
from splatview.viewer.commands import COMMANDS
from splatview.viewer.editing import cleanup, commands, files
from splatview.viewer.editing.exporting import Exporting, ExportSettings, measure_export, write_export
from splatview.viewer.editing.session import can_edit, session_of
from splatview.viewer.training.live import LiveTraining

Step = Callable[["Soaked", np.random.Generator], str | None]

MOST_STEPS = 60
"""Of a history; a user goes on with another scene then."""


class Soaked(User):
    """A `User` who edits."""

    compute = True
    """Whether OpenGL has compute shaders here."""

    @property
    def shows_training(self) -> bool:
        return (training := self.app.find(LiveTraining)) is not None and training.followed_by(self.app)

    def apply(self, operation: Operation) -> str | None:
        """As a button does."""
        if not self.app.is_open or self.app.loading is not None:
            return None
        self.post(commands.apply, operation)
        return operation.op

    def place(self, rng: np.random.Generator) -> tuple[tuple[float, float, float], float]:
        """Somewhere in the scene, and its size."""
        scene = self.app.scene
        assert scene is not None
        x, y, z = (float(v) for v in scene.centre + rng.uniform(-0.5, 0.5, 3) * scene.radius)
        return (x, y, z), float(scene.radius)


def select(user: Soaked, rng: np.random.Generator) -> str | None:
    if not user.app.is_open:
        return None
    centre, radius = user.place(rng)
    how = rng.choice(["set", "set", "add", "remove", "intersect"])
    by = Sphere(centre=centre, radius=radius * float(rng.uniform(0.1, 0.8)))
    return user.apply(Select(by=by, mode=str(how)))  # pyright: ignore[reportArgumentType]


def select_by_mouse(user: Soaked, rng: np.random.Generator) -> str | None:
    if not can_edit(user.app) or user.app.loading is not None:
        return None
    key = str(rng.choice(["R", "C"]))
    user.press(key)
    x, y = (float(value) for value in rng.uniform(0.2, 0.6, 2))
    user.drag(float(rng.uniform(20, 120)), float(rng.uniform(20, 90)), over=(x, y))
    user.calm()
    if (session := session_of(user.app)) is not None and session.tool != "none":
        user.press("Escape")
    return key


def plain(user: Soaked, rng: np.random.Generator, *, op: str) -> str | None:
    return user.apply(operation_from_json({"op": op}))


def move(user: Soaked, rng: np.random.Generator) -> str | None:
    if not user.at_rest:
        return None
    centre, radius = user.place(rng)
    w, x, y, z = (float(v) for v in rng.normal(size=4))
    a, b, c = (float(v) for v in rng.uniform(-0.2, 0.2, 3) * radius)
    return user.apply(
        Transform(
            rotation=(w, x, y, z),
            translation=(a, b, c),
            scale=float(rng.uniform(0.8, 1.25)),
            pivot=centre,
            scope="scene" if rng.uniform() < 0.3 else "selection",
        )
    )


def look(user: Soaked, rng: np.random.Generator) -> str | None:
    if not user.at_rest:
        return None
    choice, scope = int(rng.integers(0, 3)), "scene" if rng.uniform() < 0.5 else "selection"
    if choice == 0:
        return user.apply(Opacity(value=float(rng.uniform(0.3, 1.5)), scope=scope))
    if choice == 1:
        return user.apply(Size(value=float(rng.uniform(0.5, 1.5)), scope=scope))
    grade = Grade(brightness=float(rng.uniform(-0.2, 0.2)), saturation=float(rng.uniform(0, 2)))
    return user.apply(ColourGrade(grade=grade, scope=scope))


def preview(user: Soaked, rng: np.random.Generator) -> str | None:
    """A slider that is dragged, and let go or taken back."""
    session = session_of(user.app)
    if not user.at_rest or session is None:
        return None
    for _ in range(4):
        operation = Opacity(value=float(rng.uniform(0, 1)), scope="scene")
        user.post(lambda app, operation=operation: session.preview("look", operation))
    kept = rng.uniform() < 0.5
    user.post(lambda app: session.commit_preview() if kept else session.cancel_preview())
    return "kept" if kept else "cancelled"


def crop(user: Soaked, rng: np.random.Generator) -> str | None:
    if not user.app.is_open:
        return None
    centre, radius = user.place(rng)
    a, b, c = (float(v) * radius for v in rng.uniform(0.4, 1.5, 3))
    shape, keep = str(rng.choice(["box", "sphere"])), str(rng.choice(["inside", "inside", "outside"]))
    made: Any = {"shape": shape, "keep": keep, "centre": centre, "half_extents": (a, b, c)}
    crops = session.document.crops if (session := session_of(user.app)) else ()
    if not crops or rng.uniform() < 0.5:
        return user.apply(AddCrop(crop=Crop(**made)))
    index = int(rng.integers(0, len(crops)))
    choice = int(rng.integers(0, 3))
    if choice == 0:
        return user.apply(ChangeCrop(index=index, crop=Crop(**made)))
    if choice == 1:
        return user.apply(EnableCrop(index=index, enabled=not crops[index].enabled))
    return user.apply(RemoveCrop(index=index))


def uncrop(user: Soaked, rng: np.random.Generator) -> str | None:
    count = len(session.document.crops) if (session := session_of(user.app)) else 0
    for index in reversed(range(count)):
        user.apply(RemoveCrop(index=index))
    return f"{count} crops" if count else None


def slowly(user: Soaked, rng: np.random.Generator) -> str | None:
    """What runs beside the window: growing, merging, splitting, cleaning up."""
    session = session_of(user.app)
    if not user.at_rest or session is None or session.job is not None:
        return None
    choice = str(
        rng.choice(["grow", "shrink", "merge", "split", "find", "find", "prune", "duplicate", "decimate"])
    )
    document = session.document
    large = len(document.gaussians) > (3000 if user.small else 40_000)
    if choice in ("grow", "shrink"):
        user.post(commands.grow_or_shrink, (Grow if choice == "grow" else Shrink)(neighbours=4))
    elif choice == "merge" and not large:
        user.post(lambda app: session.apply_slowly(Merge(path=str(user.folder / "flat.ply")), "Reading"))
    elif choice == "split" and 0 < document.counts.selected < document.counts.kept:
        path = str(user.folder / f"part-{int(rng.integers(0, 4))}.ply")
        user.post(lambda app: session.apply_slowly(Split(path=path), "Writing"))
    elif choice == "find":
        user.post(cleanup.find, str(rng.choice(list(DETECTORS))))
    elif choice == "prune" and session.forms.clean.scores is not None:
        user.post(cleanup.prune)
    elif choice == "duplicate" and not large:
        user.post(COMMANDS["duplicate"].run)
    elif choice == "decimate" and document.counts.kept > 50:
        session.forms.clean.keep = document.counts.kept // 2
        user.post(cleanup.keep_best)
    else:
        return None
    if rng.uniform() < 0.7:
        user.calm()
        return choice
    return f"{choice}, without waiting"


def undo(user: Soaked, rng: np.random.Generator) -> str:
    keys = [str(rng.choice(["Ctrl+Z", "Ctrl+Z", "Ctrl+Y"])) for _ in range(int(rng.integers(1, 6)))]
    for key in keys:
        user.press(key)
    return " ".join(keys)


def jump(user: Soaked, rng: np.random.Generator) -> str | None:
    session = session_of(user.app)
    if not user.at_rest or session is None or not session.document.history.steps:
        return None
    position = int(rng.integers(session.document.history.floor, len(session.document.history.steps) + 1))
    user.post(commands.jump, position)
    return f"to step {position}"


def undo_all(user: Soaked, rng: np.random.Generator) -> str | None:
    """All the way back, and forth again: each state is compared as it comes by."""
    session = session_of(user.app)
    if not user.at_rest or session is None or session.job is not None:
        return None
    position = session.document.history.position
    user.post(commands.jump, 0)
    user.post(commands.jump, position)
    return f"{position} steps"


def export(user: Soaked, rng: np.random.Generator) -> str | None:
    """The file is the document, baked."""
    session = session_of(user.app)
    if not user.at_rest or session is None or session.job is not None:
        return None
    path = user.folder / "exported.ply"
    path.unlink(missing_ok=True)
    exporting = user.app.feature(Exporting)
    exporting.settings, exporting.path = ExportSettings(), str(path)
    for command in (measure_export, write_export):
        user.post(command)
        user.calm()
    document = session.document
    wanted = bake(document.gaussians, document.edits, hidden=True)
    if not len(wanted):
        return "nothing was left" if not path.exists() else fail("an empty export")
    differs = same_scene(load_scene(path), wanted)
    if differs:
        fail(f"an export differs from the document: {differs}")
    if list(user.folder.glob(".*.tmp")):
        fail("a temporary file was left")
    user.exports += 1
    return f"{len(wanted):,} splats"


def fail(text: str) -> str:
    raise Mishap(text)


def export_training(user: Soaked, rng: np.random.Generator) -> str | None:
    training = user.app.find(LiveTraining)
    if training is None:
        return None
    path = user.folder / "exported-training.ply"
    path.unlink(missing_ok=True)
    answer = training.thread.export(path)
    user.wait(answer.done, "the export")
    if training.status.gaussians == 0 or not len(load_scene(answer.result())):
        fail("the training's export is empty")
    user.exports += 1
    return ""


def recipe(user: Soaked, rng: np.random.Generator) -> str | None:
    """Written down, taken back, and done again by what was written."""
    session = session_of(user.app)
    if (
        not user.at_rest
        or session is None
        or session.job is not None
        or not session.document.history.position
    ):
        return None
    path = user.folder / "recipe.json"
    try:
        user.post(files.save_recipe_to, path)
    except InputError:
        return None
    user.post(commands.jump, 0)
    user.post(files.replay_file, path)
    user.calm()
    return f"{session.document.history.position} steps"


def edit_training(user: Soaked, rng: np.random.Generator) -> str | None:
    """Some splats of the scene in training go, or the view is let go."""
    training = user.app.find(LiveTraining)
    if training is None or not user.shows_training or training.shown is None or user.app.loading is not None:
        return None
    if rng.uniform() < 0.5 and session_of(user.app) is not None:
        user.post(training.editor.release)
        return "let go"
    centre, radius = user.place(rng)
    user.apply(Select(by=Sphere(centre=centre, radius=0.15 * radius)))
    session = session_of(user.app)
    if session is None or not 0 < session.document.counts.selected < session.document.counts.kept // 2:
        return None
    user.press("Delete")
    return "deleted"


def start_anew(user: Soaked, rng: np.random.Generator) -> str | None:
    """A long history is left behind."""
    session = session_of(user.app)
    if session is None or len(session.document.history.steps) < MOST_STEPS:
        return None
    user.drop(str(user.folder / "ball.ply"))
    app = user.app
    user.wait(lambda: app.loading is None and app.is_open and app.scene.name == "ball.ply", "it")
    return ""


EDITING: dict[str, tuple[float, Step]] = {
    "select": (5, select),
    "select_by_mouse": (2, select_by_mouse),
    **{
        op: (weight, partial(plain, op=op))
        for op, weight in {
            "select_all": 1,
            "select_none": 0.5,
            "select_inverse": 1,
            "delete": 2,
            "hide": 1,
            "show": 1,
            "lock": 0.7,
            "unlock": 0.7,
            "isolate": 0.3,
            "delete_cropped": 0.5,
        }.items()
    },
    "move": (2, move),
    "look": (2, look),
    "preview": (1, preview),
    "crop": (2, crop),
    "uncrop": (1, uncrop),
    "slowly": (3, slowly),
    "undo": (4, undo),
    "jump": (1, jump),
    "undo_all": (1, undo_all),
    "export": (2, export),
    "export_training": (0.7, export_training),
    "recipe": (0.7, recipe),
    "edit_training": (2, edit_training),
    "start_anew": (1, start_anew),
}
