"""The window itself: hello_imgui's runner around a `AppState`, a picture and the panels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from imgui_bundle.glfw_utils import glfw_window_hello_imgui  # isort: skip  (sets which libglfw is used)
import sys
from collections.abc import Callable
from functools import partial

import glfw
import moderngl
from imgui_bundle import hello_imgui, imgui, implot

from splatview.renderers.gl.context import describe
from splatview.renderers.precompile import ShaderPrecompiler
from splatview.scene import InputError
from splatview.scene.user_dirs import cache_folder
from splatview.viewer import commands, layout, theme
from splatview.viewer import open as opening
from splatview.viewer.background import WindowBackground
from splatview.viewer.camera import CameraLists
from splatview.viewer.depth_of_field import DepthOfField
from splatview.viewer.dialogs import FileDialogs
from splatview.viewer.editing.exporting import Exporting
from splatview.viewer.editing.files import Restoring, look_for_abandoned
from splatview.viewer.editing.saving import Saving
from splatview.viewer.editing.session import Editing
from splatview.viewer.film import Film
from splatview.viewer.first_views import FirstViews
from splatview.viewer.panels.settings import Appearance
from splatview.viewer.panels.start_screen import StartScreen
from splatview.viewer.panels.train_form import TrainForm
from splatview.viewer.picture import NullPicture, Picture, choose_picture
from splatview.viewer.platform import (
    best_gl_version,
    closing_on_signals,
    display_held,
    guarded,
    no_display_reason,
    rescued_from_display,
)
from splatview.viewer.preferences import Preferences, load_preferences, save_preferences
from splatview.viewer.quality.effects import Effects
from splatview.viewer.quality.state import Accuracy
from splatview.viewer.save import FilmExport
from splatview.viewer.sequence import Sequences
from splatview.viewer.state import AppState, Feature
from splatview.viewer.thumbnails import SceneThumbnails
from splatview.viewer.training import start
from splatview.viewer.training.live import LiveTraining
from splatview.viewer.training.start import Starter, TrainingStart
from splatview.viewer.view_aids import ViewAids

FEATURES: tuple[type[Feature], ...] = (
    CameraLists,
    FirstViews,
    Film,
    FilmExport,
    DepthOfField,
    WindowBackground,
    Editing,
    Restoring,
    Exporting,
    Accuracy,
    Effects,
    Sequences,
    Saving,
    SceneThumbnails,
    TrainingStart,
    StartScreen,
    TrainForm,
    ViewAids,
)
"""Features of every window, in the order in which a frame calls them; a training comes before them."""


def window_state(preferences: Preferences, training: LiveTraining | None = None) -> AppState:
    """The state of a window that is not open yet, with all features."""
    app = AppState(preferences=preferences)
    if training is not None:
        app.add(training)
    for feature in FEATURES:
        app.add(feature())
    return app


def install_drop_handler(app: AppState) -> None:
    """Opens what is dropped. To be called once hello_imgui has its window.

    Neither hello_imgui nor ImGui's GLFW backend has a drop callback of its own that would have to be
    called as well.
    """

    def dropped(_window: Any, names: Sequence[str]) -> None:
        app.post(start.open_dropped, [Path(name) for name in names])

    # pyGLFW keeps the callback alive; its stub has the C signature, not the Python one.
    glfw.set_drop_callback(glfw_window_hello_imgui(), dropped)  # pyright: ignore[reportArgumentType]


def install_close_handler(app: AppState) -> None:
    """Asks about unsaved edits where the window's own cross, or the system, closes it."""

    def closing(window: Any) -> None:
        glfw.set_window_should_close(window, False)
        app.post(commands.quit_window)

    glfw.set_window_close_callback(glfw_window_hello_imgui(), closing)  # pyright: ignore[reportArgumentType]


IDLE_FPS = 0.5
"""Frames a second when nothing happens; any event wakes the window at once. (Two took 5 % of a core where
OpenGL is software.)"""

WAITING_FPS = 12.0
"""Frames a second while something is on its way: enough for a progress bar, and it gets the cores."""

MAX_FPS = 60.0
"""Where nothing else limits the rate: without a monitor to wait for a drag would take a whole core."""

DOUBLE_CLICK_SECONDS = 0.5
"""Between the two clicks of a double click, as Windows has it."""

SAVE_SECONDS = 5.0
"""Between two looks at whether preferences have changed: a crash loses no more than that."""

SOFTWARE_FPS = 30.0
"""The same where OpenGL is software and no picture is on its way: frames take whole cores there."""

PROMPT_FRAMES = 3
"""So many follow at once on a click or a command, and wait for nothing: what it does, what that opens, and
what is seen of it. At `SOFTWARE_FPS` a click on a page was answered after 131 ms at 500,000 splats, of which
frames took 30; where frames waited for pictures as well, a deletion after 178."""

PICTURE_SECONDS = 0.1
"""For so long a frame waits there for a picture that is being drawn: shown without it, it would only have
slowed it down. Longer, and the window would no longer answer at once while a sharp picture is made."""

ACTIVE_SECONDS = 0.5
"""How long after the last event the window keeps its full rate: long enough for tooltips to appear."""

ATTENDED_SECONDS = 1.5
"""After the last touch of mouse or keys; from then on a window beside a training is drawn only as often as
`LiveTraining.idle_fps` says and when a new picture has come, and takes no frames to be smooth."""

DRIVEN_AT_MOST = 24 * 3600.0
"""Seconds, of a window that a program drives: whoever starts it says how long, so ImGui must not end it."""


class Window:
    """Ties the frame loop's callbacks to one `AppState`."""

    def __init__(
        self,
        paths: Sequence[Path],
        *,
        renderer: str = "auto",
        training: LiveTraining | None = None,
        merge: bool = False,
        starter: Starter | None = None,
    ):
        preferences, complaint = load_preferences()
        self.app = window_state(preferences, training)
        self.app.feature(TrainingStart).starter = starter
        self.app.prefer(background=preferences.background, blend=preferences.blend)
        self.app.prefer(fov_y=preferences.fov_y)
        self.dialogs = FileDialogs(recent=lambda: self.app.preferences.recent)
        if training is None:
            self.app.page, self.app.strip = preferences.page, preferences.strip
        else:
            self.app.page, self.app.strip = "Train", "Curves"
        self.app.choose_files = self.dialogs.ask
        self.failure: Exception | None = None
        self.opened = False
        self._appearance = Appearance()
        self._title = ""
        self._is_software = False
        self._ctx: moderngl.Context | None = None
        self._paths, self._merge = [Path(path) for path in paths], merge
        self._renderer = renderer
        self._precompiler: ShaderPrecompiler | None = None
        self._saved: Preferences = preferences
        self._save_due = 0.0
        self._touched = 0.0
        self._prompt_frames = 0
        self._asked = False
        self._last_view: object = None
        if complaint:
            self.app.tell(complaint)

    @property
    def training(self) -> LiveTraining | None:
        """The training that the window watches; one may begin at any time."""
        return self.app.find(LiveTraining)

    def start(self) -> None:
        """The GL context is there: make the picture and begin to load."""
        self.opened = True
        try:
            self._ctx = moderngl.create_context()
            version = self._ctx.version_code
            self._precompiler = ShaderPrecompiler(
                memory=cache_folder() / "compiled.txt",
                gl_version=(version // 100, version // 10 % 10),
                on_change=glfw.post_empty_event,
            )
            self.app.picture = self._picture(self._ctx)
        except Exception as error:
            # An exception that leaves this callback would take the process down without a word.
            self.failure = error
            return
        info = describe(self._ctx)
        self.app.gpu_name = info.renderer
        self.app.feature(Accuracy).wake = self.app.feature(Effects).wake = glfw.post_empty_event
        self.app.feature(TrainingStart).wake = glfw.post_empty_event
        self.app.feature(Sequences).wake = self.app.feature(FilmExport).wake = glfw.post_empty_event
        self._is_software = info.is_software
        install_drop_handler(self.app)
        install_close_handler(self.app)
        self.app.clipboard_read = imgui.get_clipboard_text
        if self.training is not None:
            self.training.start(self.app, on_change=glfw.post_empty_event)
            return
        if self._paths:
            opening.open_paths(self.app, self._paths, merge=self._merge)
        else:
            opening.begin_demo(self.app)
            if self.app.preferences.start_screen:
                self.app.dialog = "start"
        look_for_abandoned(self.app)

    def _picture(self, ctx: moderngl.Context) -> Picture:
        """The renderer of the window; says so where it is not the one to be expected."""
        try:
            picture = choose_picture(
                ctx, self._renderer, on_ready=glfw.post_empty_event, precompiler=self._precompiler
            )
        except Exception as error:
            if self._renderer != "auto":
                raise
            why = " ".join(str(error).split())
            self.app.complain(
                f"This driver cannot draw splats ({why}): the processor does; try splatview doctor"
            )
            return choose_picture(ctx, "cpu", on_ready=glfw.post_empty_event, precompiler=self._precompiler)
        if not picture.draws_anywhere and not describe(ctx).has_compute:
            self.app.tell(
                "This driver has no compute shaders (OpenGL 4.3): splats are drawn by its older means, their"
                " order a moment late while the view moves"
            )
        return picture

    def before_frame(self) -> None:
        """Everything that changes the state happens here, between two frames."""
        app = self.app
        params = hello_imgui.get_runner_params()
        if self.failure is not None:
            params.app_shall_exit = True
            return
        self._appearance.follow(app.preferences)
        unattended = self._unattended()
        if self._is_software and app.loading is None and not unattended and not self._prompt_frames:
            app.picture.wait(PICTURE_SECONDS)
            glfw.poll_events()  # what the mouse did meanwhile
        app.attempt(opening.continue_loading, app)
        app.attempt(opening.report_examination, app)
        app.run_posted()
        app.attempt(app.advance)
        app.attempt(app.note_statistics)
        if self.training is not None:
            window = glfw_window_hello_imgui()
            self.training.minimised = bool(glfw.get_window_attrib(window, glfw.ICONIFIED))
        for feature in app.features.values():
            app.attempt(feature.before_frame, app)
        if app.clipboard_write is not None:
            imgui.set_clipboard_text(app.clipboard_write)
            app.clipboard_write = None
        if app.scene_path is not None and self.dialogs.folder is None:
            self.dialogs.folder = app.scene_path.parent
        if (title := layout.title(app)) != self._title:
            self._title = title
            glfw.set_window_title(glfw_window_hello_imgui(), title)
        flying = commands.held_step() is not None
        # There the pictures pace the frames, not a clock: see above.
        turning = self._is_software and app.loading is None and app.picture.busy and not unattended
        params.fps_idling.fps_max = SOFTWARE_FPS if self._is_software and not turning else MAX_FPS
        playing = app.feature(Sequences).playing or app.feature(Film).playing
        params.fps_idling.enable_idling = not (app.transition or flying or turning or playing)
        idle = IDLE_FPS if self.training is None else self.training.idle_fps(app)
        params.fps_idling.fps_idle = WAITING_FPS if app.waiting or self.dialogs.open else idle
        params.fps_idling.time_active_after_last_event = 0.0 if unattended else ACTIVE_SECONDS
        if app.now() >= self._save_due:
            self._save_due = app.now() + SAVE_SECONDS
            if problem := self._save_preferences():
                app.tell(problem)
        if app.quitting:
            params.app_shall_exit = True

    def _unattended(self) -> bool:
        """Whether a training runs, its cores draw the window too, and nobody has touched that for a while."""
        app, training, io = self.app, self.training, imgui.get_io()
        mouse = io.mouse_delta.x != 0 or io.mouse_delta.y != 0 or io.mouse_wheel != 0 or any(io.mouse_down)
        if mouse or imgui.is_any_item_active() or app.view is not self._last_view:
            self._touched, self._last_view = app.now(), app.view
        if not self._is_software or training is None or training.status.state != "training":
            return False
        if app.waiting or self.dialogs.open or app.loading is not None or app.transition is not None:
            return False
        return app.now() - self._touched > ATTENDED_SECONDS

    def frame(self) -> None:
        """All that is drawn, dialogs last, and the keys that work everywhere."""
        commands.post_pressed(self.app)
        layout.show(self.app)
        layout.show_floating(self.app, self.dialogs)
        asked = any(imgui.is_mouse_clicked(i) or imgui.is_mouse_released(i) for i in range(3))
        asked = (asked or self.app.has_posted) and not self.app.feature(Sequences).playing
        if asked and not self._asked:  # what asks in every frame, as a drag does, is paced as ever
            self._prompt_frames = PROMPT_FRAMES
        self._asked = asked
        if self._prompt_frames:
            self._prompt_frames -= 1
            hello_imgui.get_runner_params().fps_idling.fps_max = 0  # no pause after this frame
        if self._ctx is not None:
            # ImGui draws next, into whatever is bound.
            self._ctx.screen.use()

    def stop(self) -> None:
        """The context still exists: end what runs, keep what is to be kept."""
        app = self.app
        app.attempt(opening.cancel_loading, app, quiet=True)
        # What is to be kept comes first: what is released may fail, and nobody would miss it.
        self.keep()
        app.attempt(self.dialogs.close)
        for feature in app.features.values():
            app.attempt(feature.close, app)
        app.attempt(self.end_precompiler)
        app.attempt(app.picture.close)
        app.picture = NullPicture()

    def end_precompiler(self) -> None:
        """Shaders that are being compiled beside the window are not waited for."""
        if self._precompiler is not None:
            self._precompiler.release()

    def keep(self) -> None:
        """Saves edits and preferences, saying on standard error what the window can no longer show."""
        for said in (self.app.feature(Editing).close_session(self.app), self._save_preferences()):
            if said:
                print(f"splatview: {said}", file=sys.stderr)

    def _save_preferences(self) -> str | None:
        """Saves them if they have changed; one line where that fails."""
        if self.app.preferences == self._saved:
            return None
        self._saved = self.app.preferences
        try:
            save_preferences(self._saved)
        except InputError as error:
            return f"the preferences cannot be saved: {error}"
        return None


@display_held()
def run_window(
    paths: Sequence[Path],
    *,
    size: tuple[int, int] = (1280, 800),
    renderer: str = "auto",
    training: LiveTraining | None = None,
    merge: bool = False,
    starter: Starter | None = None,
    drive: Callable[[AppState, Any], None] | None = None,
    rescue: Callable[[], None] = lambda: None,
) -> int:
    """Opens the window on the scenes `paths` (several are merged, also those numbered alike where `merge`
    says so; none: the demo) until it is closed.

    With a `training` it shows that one instead, and begins it; ending it is left to the caller.

    `size` is that of the window in its first run, in units of a 96-dpi screen; later runs remember.
    `renderer`: one of `picture.RENDERERS`. `drive(app, ctx)` is for tests: it runs beside the frame loop
    with ImGui's test-engine context, and the window closes when it returns. `starter` readies a training that
    is begun in the window; that is ended and saved here, after the window. `rescue` saves what the caller
    answers for where the display ends: then the process ends with it, and this does not return.

    Returns:
        0, or 1 where `drive` failed.

    Raises:
        InputError: no display can be opened, or no renderer works on it.
    """
    major, minor = best_gl_version()
    window = Window(paths, renderer=renderer, training=training, merge=merge, starter=starter)
    params = layout.runner_params(window.app, size)
    options = params.renderer_backend_options.open_gl_options
    options.major_version, options.minor_version = major, minor
    options.use_core_profile = options.use_forward_compat = True
    # ImGui smooths its own edges; multisampling only costs.
    options.anti_aliasing_samples = 0
    params.fps_idling.fps_max = MAX_FPS
    params.fps_idling.time_active_after_last_event = ACTIVE_SECONDS
    callbacks = params.callbacks
    callbacks.load_additional_fonts = theme.load_fonts
    callbacks.setup_imgui_style = theme.apply
    callbacks.setup_imgui_config = configure_imgui
    callbacks.post_init = window.start
    callbacks.pre_new_frame = partial(window.app.attempt, window.before_frame)
    callbacks.show_gui = guarded(window.app, window.frame)
    callbacks.before_exit = window.stop
    run = _Driven(params, window.app, drive) if drive else None
    implot.create_context()

    def rescue_all() -> None:
        window.keep()
        window.app.feature(TrainingStart).finish()
        rescue()
        window.end_precompiler()

    try:
        with closing_on_signals(window.app), rescued_from_display(rescue_all):
            hello_imgui.run(params)
    except RuntimeError as error:
        if window.opened:
            raise
        # It was there a moment ago, when its OpenGL versions were tried.
        raise InputError(f"no window can be opened: {no_display_reason()}") from error
    finally:
        implot.destroy_context()
        window.app.feature(TrainingStart).finish()
    if window.failure:
        raise window.failure
    return 0 if run is None or run.succeeded else 1


def configure_imgui() -> None:
    """hello_imgui's settings, but the arrow keys fly rather than walk through the panels' controls."""
    hello_imgui.imgui_default_settings.setup_default_imgui_config()
    io = imgui.get_io()
    # ImGui's own 0.3 s are missed where frames are slow: a click then counts only once a frame was drawn.
    io.mouse_double_click_time = DOUBLE_CLICK_SECONDS
    io.mouse_single_click_delay = DOUBLE_CLICK_SECONDS + 0.05
    io.config_flags &= ~int(imgui.ConfigFlags_.nav_enable_keyboard)


class _Driven:
    """Runs a test against the window with ImGui's test engine, then closes it."""

    def __init__(
        self, params: hello_imgui.RunnerParams, app: AppState, drive: Callable[[AppState, Any], None]
    ):
        self.succeeded = False
        self._app, self._drive, self._params = app, drive, params
        params.use_imgui_test_engine = True
        params.callbacks.register_tests = self._register

    def _register(self) -> None:
        engine = hello_imgui.get_imgui_test_engine()
        test = imgui.test_engine.register_test(engine, "window", "drive")
        test.test_func = self._run
        io = imgui.test_engine.get_io(engine)
        io.config_run_speed = imgui.test_engine.TestRunSpeed.fast
        io.config_watchdog_warning = io.config_watchdog_kill_test = DRIVEN_AT_MOST
        # Only what goes wrong, with the steps that led to it.
        io.config_log_to_tty = True
        io.config_verbose_level = imgui.test_engine.TestVerboseLevel.error
        io.config_verbose_level_on_error = imgui.test_engine.TestVerboseLevel.info
        imgui.test_engine.queue_test(engine, test)

    def _run(self, ctx: Any) -> None:
        try:
            self._drive(self._app, ctx)
            self.succeeded = not ctx.is_error()
        except BaseException:
            import traceback

            traceback.print_exc()
        finally:
            self._app.quitting = True
