"""Files dropped on the window: ImGui does not hand them on, so GLFW is asked directly."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from imgui_bundle.glfw_utils import glfw_window_hello_imgui  # isort: skip  (sets which libglfw is used)
import glfw

from .core import Core
from .opening import open_paths


def install_drop_handler(core: Core) -> None:
    """Opens what is dropped. To be called once hello_imgui has its window.

    Neither hello_imgui nor ImGui's GLFW backend has a drop callback of its own that would have to be
    called as well.
    """

    def dropped(_window: Any, names: Sequence[str]) -> None:
        core.post(open_paths, [Path(name) for name in names])

    # pyGLFW keeps the callback alive; its stub has the C signature, not the Python one.
    glfw.set_drop_callback(glfw_window_hello_imgui(), dropped)  # pyright: ignore[reportArgumentType]
