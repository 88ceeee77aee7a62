"""What the window knows and wants of accuracy: prices, the shortcuts taken, the frame budget. No ImGui."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from splatview.measure.knobs import Plan, apply_choices
from splatview.measure.ladder import Ladder, Measured, is_clear
from splatview.renderers.quality import Governor, Watch, is_ranked, priced, rank, unpriced, with_rest_hidden
from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, Gaussians, InputError
from splatview.scene.attribute_formats import Attributes, stored
from splatview.scene.edits import SceneEdits
from splatview.viewer.editing.session import session_of
from splatview.viewer.picture import Picture, scaled_camera
from splatview.viewer.quality.comparison import Comparing
from splatview.viewer.quality.measurement import SECONDS, Measurement
from splatview.viewer.state import Feature
from splatview.viewer.tasks import Task

if TYPE_CHECKING:
    from splatview.measure.work import Bill
    from splatview.viewer.state import AppState


UPLOAD_SECONDS = 0.004
"""Of a frame."""


class Storing:
    """Begins when made; the picture shows the form it had until the last step."""

    def __init__(self, picture: Picture, gaussians: Gaussians, attributes: Attributes):
        self.gaussians = gaussians
        self.attributes: Attributes = attributes
        self._picture = picture
        self._steps: Generator[float] | None = None
        self._rounding = Task(lambda _: stored(gaussians, attributes), name="splatview-storing")

    def advance(self) -> bool:
        """Some milliseconds of it; whether all is done. For the GL thread.

        Raises:
            InputError: the picture's renderer cannot have the scene so.
        """
        if not self._rounding.done:
            return False
        if self._rounding.result is None:
            raise InputError(f"attributes {self.attributes}: {self._rounding.error}")
        if self._steps is None:
            self._steps = self._picture.load_steps(self._rounding.result, self.attributes)
        until = time.perf_counter() + UPLOAD_SECONDS
        return all(time.perf_counter() <= until for _ in self._steps)

    def end(self) -> None:
        """Gives it up; what was shown stays."""
        self._rounding.join()
        if self._steps is not None:
            self._steps.close()


@dataclass(eq=False, kw_only=True)
class Accuracy(Feature):
    """Shortcuts taken, their prices in the open scene, and the frame budget; for the GL thread."""

    wake: Callable[[], object] = lambda: None
    """Makes an idle window draw its next frame. May be called from any thread."""
    choices: dict[str, str] = field(default_factory=dict)
    """Shortcuts taken: knob -> value as typed. Empty: exact, as far as the settings are."""
    measurement: Measurement | None = None
    """Under way."""
    ladder: Ladder | None = None
    """Prices in the open scene, as last measured."""
    bill: Bill | None = None
    """What a picture of it is in work."""
    budget_ms: float | None = None
    """What a frame may take while the camera moves; None: all that it takes."""
    comparing: Comparing = field(default_factory=Comparing)
    seconds: float = SECONDS
    """How long measuring may take where frames are quick."""
    rounds: int | None = None
    """Instead, how often each shortcut is drawn."""
    marks: dict[tuple[str, str], tuple[float, float]] = field(default_factory=dict)
    """Where each shortcut is on the plot drawn last, px of the screen, by knob and value."""
    note: str = ""
    """What the picture drawn last leaves out because the camera moves, or ""."""
    progress: Watch = field(default_factory=lambda: Watch(Governor(1000 / 60)))
    stored: Attributes = "float32"
    """How the renderer has the open scene now, and..."""
    storing: Storing | None = None
    """... how it is getting it."""
    _kept: float = 1.0
    _ranking: Task[None] | None = None
    """Finds out what a share of the splats would keep."""
    _hidden: tuple[Any, Any, SceneEdits | None] | None = None
    _camera: Camera | None = None
    _gaussians: Gaussians | None = None
    _name: str = ""
    _frames_seen: int = 0
    _full_ms: float = 0.0

    def measure(self, app: AppState) -> None:
        """Begins to measure the view that is seen, where nothing is being measured."""
        if self.choices.get("attributes", "float32") != "float32":
            app.complain("Choose float32 attributes first: shortcuts are measured on the exact scene")
        elif self.measurement is None and app.is_open:
            self.measurement = Measurement(app, seconds=self.seconds, rounds=self.rounds, wake=self.wake)

    def cancel_measuring(self) -> None:
        if self.measurement is not None:
            self.measurement.cancel()

    def choose(self, app: AppState, knob: str, value: str) -> None:
        """Takes a shortcut. Raises InputError where the renderer does not have it."""
        plan = apply_choices(Plan(), {knob: value}, app.picture.backend)
        problem = app.picture.unsupported(FrameRequest(None, app.camera, plan.settings))
        if problem is not None:
            raise InputError(problem)
        self.choices[knob] = value

    def exact(self) -> None:
        """Takes all shortcuts back."""
        self.choices.clear()

    def hold(self, app: AppState, budget_ms: float | None) -> None:
        """Sets the frame budget, or gives it up."""
        self.budget_ms = budget_ms
        if budget_ms is not None:
            self.progress.governor.set_budget(budget_ms)
            if not self.progress.governor.steps and self._full_ms > 0:
                # Until prices are known.
                self.progress.governor.follow(unpriced(self._full_ms))
        app.picture.budget_ms = budget_ms

    def plan(self, app: AppState) -> Plan:
        """The settings with the shortcuts taken."""
        plan = Plan(settings=app.seen_settings)
        if self.choices:
            plan = apply_choices(plan, self.choices, app.picture.backend)
        return plan

    def next_frame(self, app: AppState) -> FrameRequest:
        """What the frame that comes is drawn by: of the loaded scene, on the pixels that are drawn."""
        plan, camera, self.note = self.plan(app), app.camera, ""
        moved = self._camera is not None and not self._camera.same_view(camera)
        self._camera = camera
        if self.governs(app):
            step = self.progress.next(moved=moved)
            if step is not None and not step.is_exact:
                # One's own shortcuts stay, unless the budget asks for more of the same.
                plan = apply_choices(plan, dict(step.choices), app.picture.backend)
                scale, kept = plan.resolution * step.scale, min(plan.kept, step.kept)
                plan = replace(plan, resolution=scale, kept=kept)
                self.note = step.note
        self._kept = plan.kept if app.mode == "splats" else 1.0
        camera = scaled_camera(camera, app.preferences.resolution_scale * plan.resolution)
        more = {"mode": app.mode, "edits": self._edits(app), "highlight": app.highlight}
        return FrameRequest(None, camera, plan.settings, **more)

    def _edits(self, app: AppState) -> SceneEdits | None:
        """Those that the frame that comes is drawn with: what a shortcut leaves out is hidden."""
        edits = app.edits
        if self._kept >= 1 or not app.is_open:
            self._hidden = None
            return edits
        if not is_ranked(app.scene.gaussians):
            self._rank(app.scene.gaussians)
            return edits  # all, until it is known what can be left out
        key = (app.scene.gaussians, self._kept, edits)
        versions = edits and (edits.marks_version, edits.palette_version, edits.crops_version)
        held = self._hidden
        if held is None or any(a is not b for a, b in zip(held[0], key, strict=True)) or held[1] != versions:
            held = (key, versions, with_rest_hidden(*key))
            self._hidden = held
        return held[2]

    def _rank(self, gaussians: Gaussians) -> None:
        if self._ranking is not None and not self._ranking.done:
            return
        self._ranking = Task(lambda _: rank(gaussians), name="splatview-rank", on_done=self.wake)

    def governs(self, app: AppState) -> bool:
        """Whether a budget is held here; the CPU's pictures hold theirs where they are drawn."""
        return self.budget_ms is not None and not app.picture.draws_anywhere and app.mode == "splats"

    def busy(self, app: AppState) -> bool:
        governed = self.budget_ms is not None and not self.progress.resting
        loading = self.measurement is not None or self.storing is not None
        ranking = self._ranking is not None and not self._ranking.done
        return loading or governed or ranking or self.comparing.busy

    def before_frame(self, app: AppState) -> None:
        """Takes over what was measured, and learns from the latest frame."""
        gaussians = app.scene.gaussians
        if self.measurement is not None and self.measurement.gaussians is not gaussians:
            self.measurement.cancel()
        if self._gaussians is not gaussians:
            # Another scene, or the next moment of one that trains: prices and times are of the old one.
            self._gaussians, self.ladder, self.bill = gaussians, None, None
            self.stored = "float32"  # as scenes are loaded
            self._full_ms = 0.0
            self.progress.governor.follow(())
        if self._name != app.scene.name:
            self._name = app.scene.name
            self.choices.clear()
        if self.measurement is not None and self.measurement.done:
            self._collect(app, self.measurement)
        self._store(app)
        self._learn(app)

    def _store(self, app: AppState) -> None:
        """Loads the scene in the form that was chosen, where it is in another."""
        if not app.is_open or app.loading is not None:
            return
        session = session_of(app)
        if session is not None and session.loading is not None:
            return
        if session is None and app.scene.sequence is not None:
            return  # another frame is about to be shown
        wanted: Any = self.choices.get("attributes", "float32")
        gaussians, made = app.scene.gaussians, self.storing
        if made is not None and (made.gaussians is not gaussians or made.attributes != wanted):
            made.end()
            self.storing = made = None
        if made is None and wanted != self.stored:
            self.storing = made = Storing(app.picture, gaussians, wanted)
        if made is None:
            return
        try:
            done = made.advance()
        except InputError as error:
            self.choices.pop("attributes", None)
            self.storing = None
            app.complain(str(error))
            return
        if done:
            self.storing, self.stored = None, made.attributes

    def _collect(self, app: AppState, made: Measurement) -> None:
        self.measurement = None
        if made.problem is not None:
            app.complain(made.problem)
        elif made.ladder is not None and made.gaussians is app.scene.gaussians:
            self.ladder, self.bill = made.ladder, made.bill
            self.progress.governor.follow(priced(made.ladder.baseline, made.ladder.rungs))
            app.tell(f"Prices of {len(made.ladder.rungs) - 1} shortcuts measured in this view")

    def _learn(self, app: AppState) -> None:
        stats = app.stats
        if stats.drawn == self._frames_seen or self.measurement is not None:
            return
        self._frames_seen = stats.drawn
        milliseconds = sum(stats.ms.values())
        if not milliseconds > 0:
            return
        if not self.governs(app):
            self._full_ms = milliseconds
        elif self.progress.governor.steps:
            self.progress.took(milliseconds)
        else:
            self.progress.governor.follow(unpriced(milliseconds))

    def close(self, app: AppState) -> None:
        if self.measurement is not None:
            self.measurement.cancel()
            self.measurement.join()
            self.measurement = None
        if self.storing is not None:
            self.storing.end()
            self.storing = None
        self.comparing.end()


def price_of(one: Measured, ladder: Ladder) -> str:
    """What a rung saves and costs, in a line: "saves 3.1 ms, 41.2 dB, largest error 0.031"."""
    saved = ladder.baseline.ms * (1 - one.ratio)
    if not is_clear(one):
        time = "no faster"
    else:
        time = f"saves {saved:.1f} ms" if saved > 0 else f"costs {-saved:.1f} ms"
    return f"{time}, {one.psnr:.1f} dB, largest error {one.max_error:.2g}"


def choose(app: AppState, knob: str, value: str) -> None:
    """Draws by a shortcut from now on."""
    try:
        app.feature(Accuracy).choose(app, knob, value)
    except InputError as error:
        app.complain(str(error))
