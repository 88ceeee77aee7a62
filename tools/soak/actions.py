"""Everything that a user of the soak may do, with how often. An action returns what it did, or None where
that is not possible just now."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import moderngl
import numpy as np
from actions_editing import EDITING, Soaked
from harm import HARM
from imgui_bundle.glfw_utils import glfw_window_hello_imgui
from scenes import BROKEN, GOOD

from splatview.measure.knobs import KNOBS, Plan
from splatview.viewer import open as opening
from splatview.viewer.commands import COMMANDS
from splatview.viewer.editing.session import session_of
from splatview.viewer.entries import open_page
from splatview.viewer.picture import choose_picture
from splatview.viewer.quality.comparison import RIGHTS
from splatview.viewer.quality.measurement import applicable
from splatview.viewer.quality.state import Accuracy, choose
from splatview.viewer.state import AppState
from splatview.viewer.training import live as training
from splatview.viewer.training.live import LiveTraining

import glfw  # isort: skip  (after imgui_bundle, which says which libglfw that is)

__all__ = ["ACTIONS", "Soaked"]


# ---- the view


def orbit(user: Soaked, rng: np.random.Generator) -> str:
    dx, dy = (float(value) for value in rng.uniform(-150, 150, 2))
    user.drag(dx, dy, int(rng.integers(0, 2)))
    return f"drag by {dx:.0f}, {dy:.0f}"


def fly(user: Soaked, rng: np.random.Generator) -> str:
    key = str(rng.choice(list("WASDQE")))
    user.hold(key, float(rng.uniform(0.05, 0.4)))
    return key


def zoom(user: Soaked, rng: np.random.Generator) -> str:
    user.point(0.5, 0.5)
    notches = float(rng.integers(-3, 4))
    user.ctx.mouse_wheel_y(notches)
    return f"{notches:g}"


def focus(user: Soaked, rng: np.random.Generator) -> str:
    user.point(*(float(value) for value in rng.uniform(0.2, 0.8, 2)))
    user.ctx.mouse_double_click(0)
    return ""


def key(user: Soaked, rng: np.random.Generator) -> str:
    chosen = str(rng.choice(["F", "X", "Y", "Z", "F2", "F3", "F4", "L", "U", "B", "N", "PageDown", "Home"]))
    user.press(chosen)
    return chosen


def mode(user: Soaked, rng: np.random.Generator) -> str:
    chosen = str(rng.choice(list("1112345")))
    user.press(chosen)
    return chosen


def home(user: Soaked, rng: np.random.Generator) -> str:
    """Back to where something is to be seen, in full."""
    user.press("1")
    user.press("F")
    user.app.prefer(resolution_scale=1.0)
    user.post(lambda app: app.feature(Accuracy).exact())
    user.post(user.app.feature(Accuracy).hold, None)
    return ""


# ---- the window


def resize(user: Soaked, rng: np.random.Generator) -> str:
    width, height = int(rng.integers(420, 1200)), int(rng.integers(300, 800))
    user.on_gl_thread(lambda: glfw.set_window_size(glfw_window_hello_imgui(), width, height))
    user.frames(3)
    return f"{width}x{height}"


def panels(user: Soaked, rng: np.random.Generator) -> str:
    name = str(rng.choice(["toggle_panels", "toggle_help", "toggle_palette", "screenshot_as"]))
    user.post(COMMANDS[name].run)
    user.frames(3)
    user.app.dialog, user.app.panels_hidden = None, False
    user.frames(3)
    return name


def screenshot(user: Soaked, rng: np.random.Generator) -> str:
    user.post(COMMANDS["screenshot"].run)
    for path in user.folder.glob("*.png"):
        if not path.name.startswith("wrong-"):
            path.unlink()
    return ""


def settings(user: Soaked, rng: np.random.Generator) -> str:
    app = user.app
    choice = int(rng.integers(0, 6))
    if choice == 0:
        r, g, b = (float(value) for value in rng.uniform(0, 1, 3))
        app.prefer(background=(r, g, b))
    elif choice == 1:
        app.prefer(resolution_scale=float(rng.choice([0.5, 1.0, 1.0, 1.5])))
    elif choice == 2:
        app.prefer(blend="float32" if app.preferences.blend == "float16" else "float16")
    elif choice == 3:
        degree = [None, None, 0, 1][int(rng.integers(0, 4))]
        app.settings = replace(app.settings, sh_degree=degree)
    elif choice == 4:
        model = app.settings.model
        app.settings = replace(app.settings, model=replace(model, antialiased=not model.antialiased))
    else:
        app.prefer(fov_y=float(rng.uniform(20, 100)))
    user.frames(2)
    return str(choice)


def renderer(user: Soaked, rng: np.random.Generator) -> str:
    """The same window drawn by another renderer."""
    names = ["cpu", "quads", "tiles"] if user.compute else ["cpu", "quads"]
    chosen = str(rng.choice(names))
    user.post(lambda app: app.feature(Accuracy).exact())
    user.post(lambda app: app.feature(Accuracy).cancel_measuring())
    user.calm()
    user.post(switch, chosen)
    return chosen


def switch(app: AppState, name: str) -> None:
    old, session = app.picture, session_of(app)
    assert old is not None
    new = choose_picture(moderngl.get_context(), name, on_ready=glfw.post_empty_event)
    scene = session.document.gaussians if session else app.scene.gaussians
    if live := app.find(LiveTraining):
        live._drop_arriving()
    if session is not None and session.loading is not None:
        session.loading[1].close()
        session.loading = None
    for _ in new.load_steps(scene):
        pass
    if session is not None:
        session.loaded = scene
    app.picture = new
    old.close()
    app.feature(Accuracy).hold(app, app.feature(Accuracy).budget_ms)


# ---- scenes


def open_scene(user: Soaked, rng: np.random.Generator) -> str:
    name = str(rng.choice(GOOD))
    user.drop(str(user.folder / name))
    if rng.uniform() < 0.8:
        app = user.app
        user.wait(lambda: app.loading is None and app.is_open and app.scene.name == name, name)
        return name
    return f"{name}, without waiting"


def open_two(user: Soaked, rng: np.random.Generator) -> str:
    names = [str(name) for name in rng.choice(GOOD, 2, replace=False)]
    user.drop(*(str(user.folder / name) for name in names))
    return " and ".join(names)


def open_broken(user: Soaked, rng: np.random.Generator) -> str:
    before = user.app.scene
    user.drop(str(user.folder / BROKEN))
    user.wait(lambda: user.app.problem is not None, "the refusal")
    # By its files: an edit that was under way may have changed its splats.
    if before.paths != user.app.scene.paths and not user.shows_training:
        raise AssertionError("the old scene is gone")
    return BROKEN


def reload(user: Soaked, rng: np.random.Generator) -> str | None:
    if not user.app.is_open or user.shows_training:
        return None
    user.post(opening.reload)
    return user.app.scene.name


def cancel_load(user: Soaked, rng: np.random.Generator) -> str:
    user.post(opening.begin_demo)
    user.post(opening.cancel_loading)
    return ""


# ---- training


def back_to_training(user: Soaked, rng: np.random.Generator) -> str | None:
    if user.shows_training or user.app.loading is not None:
        return None
    user.post(training.show_training)
    user.wait(
        lambda: (training := user.app.find(LiveTraining)) is not None and training.shown is not None,
        "the training",
    )
    return ""


def pause_or_resume(user: Soaked, rng: np.random.Generator) -> str:
    user.post(training.pause_or_resume)
    return ""


def step_once(user: Soaked, rng: np.random.Generator) -> str:
    user.post(training.step_once)
    return ""


def change_recipe(user: Soaked, rng: np.random.Generator) -> str:
    limit = int(rng.integers(300, 1500 if user.small else 4000))
    changes = {"max_splats": limit, "means_rate": float(rng.uniform(1e-4, 3e-4))}
    user.post(lambda app: training.change_settings(app, **changes))
    return f"at most {limit}"


def measure_photos(user: Soaked, rng: np.random.Generator) -> str:
    user.post(training.evaluate)
    return ""


def save_training(user: Soaked, rng: np.random.Generator) -> str:
    user.post(training.save_checkpoint if rng.uniform() < 0.5 else training.stop_and_save)
    return ""


def photo(user: Soaked, rng: np.random.Generator) -> str:
    index = int(rng.integers(0, 10))
    user.post(training.go_to_photo, index)
    return str(index)


def shares(user: Soaked, rng: np.random.Generator) -> str:
    share, updates = float(rng.uniform(0.05, 1)), str(rng.choice(["off", "low", "live", "live"]))
    user.app.prefer(training_share=share, training_updates=updates)
    return f"{share:.2f}, {updates}"


# ---- accuracy


def shortcut(user: Soaked, rng: np.random.Generator) -> str:
    knobs = [
        (knob.name, value.text)
        for knob in KNOBS
        for value in knob.values_for(user.renderer)
        if applicable(value.apply(Plan())) and (user.compute or knob.name not in ("order", "resort"))
    ]
    name, value = knobs[int(rng.integers(0, len(knobs)))]
    user.post(choose, name, value)
    return f"--{name} {value}"


def exact(user: Soaked, rng: np.random.Generator) -> str:
    user.post(lambda app: app.feature(Accuracy).exact())
    return ""


def budget(user: Soaked, rng: np.random.Generator) -> str:
    milliseconds = None if rng.uniform() < 0.5 else float(rng.uniform(4, 60))
    user.post(user.app.feature(Accuracy).hold, milliseconds)
    return str(milliseconds)


def measure(user: Soaked, rng: np.random.Generator) -> str:
    user.app.feature(Accuracy).seconds = 0.3
    user.post(open_page, "Accuracy")
    user.post(user.app.feature(Accuracy).measure)
    if rng.uniform() < 0.5:
        user.frames(int(rng.integers(1, 20)))
        user.post(lambda app: app.feature(Accuracy).cancel_measuring())
        return "cancelled"
    return ""


def compare(user: Soaked, rng: np.random.Generator) -> str:
    user.app.feature(Accuracy).comparing.right = RIGHTS[int(rng.integers(0, len(RIGHTS)))]
    user.frames(5)
    return user.app.feature(Accuracy).comparing.right


ACTIONS: dict[str, tuple[float, Callable[[Soaked, np.random.Generator], Any]]] = {
    "orbit": (6, orbit),
    "fly": (2, fly),
    "zoom": (2, zoom),
    "focus": (1, focus),
    "key": (2, key),
    "mode": (2, mode),
    "home": (4, home),
    "resize": (2, resize),
    "panels": (1, panels),
    "screenshot": (0.5, screenshot),
    "settings": (3, settings),
    "renderer": (2, renderer),
    "open_scene": (4, open_scene),
    "open_two": (1, open_two),
    "open_broken": (1, open_broken),
    "reload": (1, reload),
    "cancel_load": (0.5, cancel_load),
    "back_to_training": (4, back_to_training),
    "pause_or_resume": (1, pause_or_resume),
    "step_once": (1, step_once),
    "change_recipe": (1, change_recipe),
    "measure_photos": (0.5, measure_photos),
    "save_training": (0.5, save_training),
    "photo": (1, photo),
    "shares": (1, shares),
    "shortcut": (2, shortcut),
    "exact": (2, exact),
    "budget": (1, budget),
    "measure": (0.3, measure),
    "compare": (1, compare),
    **EDITING,
    **HARM,
}
"""Name -> weight and what is done."""
