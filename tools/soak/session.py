"""One part of the soak: a window that trains, and a user who does things at random. Run by `soak`.

usage: session.py OPTIONS.json-text
"""

from __future__ import annotations

import gc
import json
import sys
import threading
import time
import traceback
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
from actions import ACTIONS, Soaked
from checks import Memory, Mishap, idle_threads
from scenes import make_capture, make_scenes

from splatview.cli import train
from splatview.cli import train as train_window
from splatview.edit import warm_up as editing_kernels
from splatview.raster import render
from splatview.renderers.edit_snapshot import tinted
from splatview.renderers.request import Highlight
from splatview.scene import look_at
from splatview.scene.edits import SELECTED, SceneEdits
from splatview.scene.formats import load_scene
from splatview.trainer import warm_up as training_kernels
from splatview.trainer.checkpoint import load_checkpoint
from splatview.viewer import dialogs as file_dialogs
from splatview.viewer.state import AppState

LOOK_EVERY = 8
"""Actions between two looks at everything."""


class Session:
    """Does actions until the time is up, or what a log says."""

    def __init__(self, options: dict[str, Any], folder: Path):
        self.options, self.folder = options, folder
        self.problems: list[str] = []
        self.done: dict[str, int] = {}
        self.memory = Memory()
        self.user: Soaked | None = None
        self.seconds = 0.0
        self.steps = 0
        self.threads: dict[str, int] = {}
        self._log = open(options["log"], "w", buffering=1)  # noqa: SIM115, as long as the process
        threading.excepthook = self._thread_died

    def _thread_died(self, args: threading.ExceptHookArgs) -> None:
        name = args.thread.name if args.thread else "a thread"
        text = "".join(traceback.format_exception(args.exc_type, args.exc_value, args.exc_traceback))
        self.problems.append(f"{name} died: {args.exc_type.__name__}: {args.exc_value}")
        print(text, file=sys.stderr)

    def plan(self) -> Any:
        """(number, name) of one action after the other."""
        if self.options["replay"] is not None:
            for line in Path(self.options["replay"]).read_text().splitlines():
                entry = json.loads(line)
                if "action" in entry:
                    yield entry["n"], entry["action"]
            return
        names, weights = list(ACTIONS), np.array([weight for weight, _ in ACTIONS.values()], float)
        until = time.monotonic() + self.options["seconds"]
        number = 0
        while time.monotonic() < until:
            choice = np.random.default_rng([self.options["seed"], number, 0])
            yield number, names[int(choice.choice(len(names), p=weights / weights.sum()))]
            number += 1

    def act(self, app: AppState, ctx: Any) -> None:
        """Called with the window open, in place of a person."""
        file_dialogs.has_native_dialogs = lambda: False
        app.prefer(smooth=False, recent=())
        user = self.user = Soaked(app, ctx, self.folder, small=self.options["size"] == "small")
        user.compute = user.on_gl_thread(lambda: moderngl.get_context().version_code) >= 430
        began = time.monotonic()
        number, name = -1, "the start"
        try:
            user.wait(lambda: app.is_open, "the first snapshot")
            for number, name in self.plan():
                self._log.write(
                    json.dumps({"n": number, "action": name, "at": round(time.monotonic() - began, 2)}) + "\n"
                )
                rng = np.random.default_rng([self.options["seed"], number, 1])
                did = ACTIONS[name][1](user, rng)
                user.look_for_harm()
                self.done[name] = self.done.get(name, 0) + (did is not None)
                self._log.write(json.dumps({"n": number, "did": did}) + "\n")
                if number % LOOK_EVERY == LOOK_EVERY - 1:
                    user.look_at_everything()
                    self.memory.note(app, time.monotonic() - began)
                if self.problems:
                    raise Mishap("see above")
            user.look_at_everything()
            self.memory.note(app, time.monotonic() - began)
            self.threads = idle_threads()
        except BaseException as error:
            traceback.print_exc()
            self.problems.append(f"action {number}, {name}: {type(error).__name__}: {error}")
        finally:
            self.seconds = time.monotonic() - began

    def result(self) -> dict[str, Any]:
        user = self.user
        assert user is not None
        self.problems += self.memory.problems()
        return {
            "problems": self.problems,
            "seconds": round(self.seconds, 1),
            "actions": sum(self.done.values()),
            "by_name": dict(sorted(self.done.items())),
            "pictures": user.pictures.compared,
            "largest_share_off": user.pictures.largest_share_off,
            "exports": user.exports,
            "undos": user.undone.checked,
            "steps": self.steps,
            "memory": self.memory.summary(),
            "threads": self.threads,
        }


def ready_kernels(folder: Path) -> None:
    """Compiles what the window will ask for first: on a busy machine that takes minutes, in which it would
    look as if it never came to rest."""
    training_kernels.warm_up()
    editing_kernels.warm_up()
    scene = load_scene(folder / "one.ply")
    edits = SceneEdits(marks=np.full(len(scene), SELECTED, np.uint32), flags=SELECTED)
    render(scene, look_at((0, 0, -4), (0, 0, 0), width=32, height=32), edits=tinted(edits, Highlight()))


def main() -> int:
    options = json.loads(sys.argv[1])
    folder = Path.cwd()
    small = options["size"] == "small"
    make_scenes(folder, small=small)
    ready_kernels(folder)
    capture = make_capture(folder, small=small)
    session = Session(options, folder)
    arguments = [str(capture), "-o", "trained.ply", "--iterations", "10000000", "--max-splats"]
    parsed = train.make_parser().parse([*arguments, "1500" if small else "4000"])
    assert parsed is not None
    code = train_window.train_in_window(
        parsed,
        time.perf_counter(),
        lambda run: "",
        drive=session.act,
        size=(800, 560) if small else (1000, 700),
        renderer=options["renderer"],
    )
    # The window is gone: training has saved what there is, and every thread of the window has ended.
    try:
        checkpoint = load_checkpoint(folder / "trained.checkpoint.safetensors")
        session.steps = checkpoint.counters.iteration
        saved = load_scene(folder / "trained.ply")
        if not np.array_equal(saved.means, checkpoint.parameters.means):
            session.problems.append("scene and checkpoint are of different moments")
    except Exception as error:
        session.problems.append(f"what training left: {type(error).__name__}: {error}")
    gc.collect()
    names = {thread.name for thread in threading.enumerate() if thread.name.startswith("splatview-")}
    left = sorted(names - {"splatview-warm-up"})  # which compiles, and nobody waits for
    if left:
        session.problems.append(f"threads live on after the window has closed: {', '.join(left)}")
    Path(options["result"]).write_text(json.dumps(session.result(), indent=1))
    return code


if __name__ == "__main__":
    sys.exit(main())
