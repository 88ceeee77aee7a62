"""What the program has said, newest at the bottom."""

from __future__ import annotations

import time

from imgui_bundle import imgui

from .. import theme
from ..core import Core
from . import widgets


def show(core: Core) -> None:
    if not core.messages:
        widgets.note("Nothing to report.")
        return
    follow = imgui.get_scroll_y() >= imgui.get_scroll_max_y() - 1
    for message in core.messages:
        clock = time.strftime("%H:%M:%S", time.localtime(message.at))
        imgui.text_colored(theme.QUIET, clock)
        imgui.same_line()
        imgui.push_text_wrap_pos(0)
        if message.error:
            imgui.text_colored(theme.ERROR, message.text)
        else:
            imgui.text_unformatted(message.text)
        imgui.pop_text_wrap_pos()
        if imgui.is_item_clicked(imgui.MouseButton_.right):
            imgui.set_clipboard_text(message.text)
        widgets.tooltip("Right click copies the line")
    if follow:
        imgui.set_scroll_here_y(1.0)
