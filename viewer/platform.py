"""The platform: failing frames, signals, a lost display, OpenGL versions, priority of threads."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from imgui_bundle import imgui

from splatview.viewer.state import AppState

import imgui_bundle  # noqa: F401 - isort: skip  (sets which libglfw is used)
import glfw

from splatview.renderers.gl.context import GL_VERSIONS
from splatview.scene import InputError

DISPLAY_LOST = 2
"""Exit code, as of everything that the user has to put right."""

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
"""Names of those that ask for an end; the last is a terminal or a connection that is closed."""


def guarded(app: AppState, show: Callable[[], object]) -> Callable[[], None]:
    """`show`, which draws with ImGui. Where it fails, ImGui is put back to where it was before and the user
    is told: an exception that left here would end the process, in the middle of a frame and without a word.
    """

    def run() -> None:
        before = imgui.internal.ErrorRecoveryState()
        imgui.internal.error_recovery_store_state(before)
        try:
            show()
        except Exception as error:
            put_back(before)
            app.fail(error)

    return run


def put_back(before: imgui.internal.ErrorRecoveryState) -> None:
    """Ends the windows, tables and styles that were begun since, quietly."""
    io = imgui.get_io()
    names = ("enable_assert", "enable_tooltip", "enable_debug_log")
    kept = {name: getattr(io, f"config_error_recovery_{name}") for name in names}
    for name in names:
        setattr(io, f"config_error_recovery_{name}", False)
    try:
        imgui.internal.error_recovery_try_to_recover_state(before)
    finally:
        for name, value in kept.items():
            setattr(io, f"config_error_recovery_{name}", value)


@contextmanager
def closing_on_signals(app: AppState) -> Iterator[None]:
    """Within, Ctrl-C and requests to end close the window as a click does: an exception in the middle of a
    frame would end the process before edits and preferences are put away. A second Ctrl-C does so."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def close(number: int, _: Any) -> None:
        if app.quitting and number == signal.SIGINT:
            raise KeyboardInterrupt
        app.quitting = True

    numbers = [getattr(signal, name) for name in SIGNALS if hasattr(signal, name)]
    # Who ignores one, as nohup does, has a reason.
    heeded = [number for number in numbers if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, close) for number in heeded}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def rescued_from_display(rescue: Callable[[], None]) -> Iterator[None]:
    """Within, a display that ends (the X server, or the connection to it) ends the process with one line,
    after `rescue` has saved what there is. Xlib would end it at once; there is no way back from there.

    Elsewhere than under X11 nothing is needed: no display, no process, or a window that is closed.
    """
    xlib = _xlib()
    if xlib is None:
        yield
        return
    once = threading.Lock()

    def lost(_display: Any) -> int:
        if not once.acquire(blocking=False):
            while True:  # another thread, or the rescue itself, has come upon it as well
                time.sleep(1)
        try:
            print("splatview: the connection to the display was lost", file=sys.stderr)
            rescue()
        except BaseException as error:
            print(f"splatview: {' '.join(str(error).split()) or type(error).__name__}", file=sys.stderr)
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(DISPLAY_LOST)

    handler_type = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)
    handler = handler_type(lost)
    xlib.XSetIOErrorHandler.restype = ctypes.c_void_p
    xlib.XSetIOErrorHandler.argtypes = [ctypes.c_void_p]
    before = xlib.XSetIOErrorHandler(ctypes.cast(handler, ctypes.c_void_p))
    try:
        yield
    finally:
        xlib.XSetIOErrorHandler(before)


@contextmanager
def display_held() -> Iterator[None]:
    """Within, this process has a connection to the X server, whatever GLFW opens and closes: a server that
    starts anew when its last client leaves (Xvfb does) refuses the next one meanwhile, which was the window
    after the look at its OpenGL versions. Nothing elsewhere, or where there is no server."""
    xlib = None if os.environ.get("WAYLAND_DISPLAY") else _xlib()
    if xlib is None:
        yield
        return
    xlib.XOpenDisplay.restype = ctypes.c_void_p
    xlib.XOpenDisplay.argtypes = [ctypes.c_char_p]
    xlib.XCloseDisplay.argtypes = [ctypes.c_void_p]
    connection = xlib.XOpenDisplay(None)
    try:
        yield
    finally:
        if connection:
            xlib.XCloseDisplay(connection)


def _xlib() -> Any:
    """libX11, which GLFW has loaded; None where windows are made otherwise."""
    if not sys.platform.startswith("linux") or not os.environ.get("DISPLAY"):
        return None
    try:
        return ctypes.CDLL("libX11.so.6")
    except OSError:
        return None


def display_problem() -> str | None:
    """One line on why no window can be opened here, or None where one can."""
    try:
        best_gl_version()
    except InputError as error:
        return str(error)
    return None


def best_gl_version() -> tuple[int, int]:
    """The newest version of `GL_VERSIONS` that a window here gets.

    A window is tried for each, unseen, since asking for more than the driver has is fatal later.

    Raises:
        InputError: there is no display, or its OpenGL is older than 3.3.
    """
    reasons: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if not glfw.init():
            raise InputError(f"no window can be opened: {no_display_reason()}")
        try:
            for code in GL_VERSIONS:
                major, minor = code // 100, code // 10 % 10
                glfw.default_window_hints()
                glfw.window_hint(glfw.VISIBLE, False)
                glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, major)
                glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, minor)
                glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
                glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, True)
                window = glfw.create_window(16, 16, "", None, None)
                if window:
                    glfw.destroy_window(window)
                    return major, minor
                reason = glfw.get_error()[1] or b"no reason given"
                reasons.append(reason.decode(errors="replace") if isinstance(reason, bytes) else str(reason))
        finally:
            glfw.terminate()
    raise InputError(
        f"no window with OpenGL 3.3 can be opened here ({reasons[-1]}); update the graphics driver, or see"
        " what splatview doctor finds"
    )


def no_display_reason() -> str:
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        return "there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set)"
    return "the display cannot be reached"


NICENESS = 10
"""Linux weighs a thread of it 110 against 1,024 (sched(7)): where both want a core, training has nine tenths
of it, and the window still answers. A core that training leaves free is the window's as before."""


def give_way() -> bool:
    """Lowers the priority of the calling thread, and of threads that it starts from now on, those of its
    OpenGL driver among them; whether that is possible. It cannot be taken back.

    Only Linux has a priority for each thread that threads inherit; elsewhere the shares of the cores are
    kept by waiting alone.
    """
    if sys.platform != "linux":
        return False
    try:
        os.setpriority(os.PRIO_PROCESS, 0, max(os.getpriority(os.PRIO_PROCESS, 0), NICENESS))
    except OSError:
        return False
    return True
