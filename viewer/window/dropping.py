"""Files dropped on the window: ImGui does not hand them on, so GLFW is asked directly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from imgui_bundle.glfw_utils import glfw_window_hello_imgui  # isort: skip  (sets which libglfw is used)
import glfw

from .core import Core
from .opening import open_paths


def install_drop_handler(core: Core) -> Callable[[Any, Sequence[str]], None]:
    """Opens what is dropped; a handler that was there before is called too. Returns the handler.

    To be called once hello_imgui has its window.
    """
    window = glfw_window_hello_imgui()
    previous: Callable[..., None] | None = None

    def dropped(window: Any, names: Sequence[str]) -> None:
        if previous is not None:
            previous(window, names)
        core.post(open_paths, [Path(name) for name in names])

    previous = glfw.set_drop_callback(window, dropped)
    return dropped
