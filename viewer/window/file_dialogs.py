"""The system's file dialogs, and a plain one to type a path into where there is none."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from imgui_bundle import imgui
from imgui_bundle import portable_file_dialogs as pfd

Kind = Literal[
    "scene", "cameras", "picture", "save_picture", "save_camera", "save_scene", "recipe", "save_recipe"
]

FILTERS: dict[Kind, list[str]] = {
    "scene": ["Splat scenes", "*.ply *.splat *.spz *.ksplat *.sog", "All files", "*"],
    "cameras": ["Camera lists", "*.json *.bin *.txt", "All files", "*"],
    "picture": ["Pictures", "*.jpg *.jpeg *.png *.webp *.tif *.tiff *.bmp", "All files", "*"],
    "save_picture": ["PNG pictures", "*.png"],
    "save_camera": ["Cameras", "*.json"],
    "save_scene": ["Splat scenes", "*.ply"],
    "recipe": ["Recipes", "*.json", "All files", "*"],
    "save_recipe": ["Recipes", "*.json"],
}

LINUX_PROGRAMS = ("zenity", "kdialog", "qarma", "matedialog")
"""What portable-file-dialogs can start there; without one its dialogs never appear."""


def has_native_dialogs() -> bool:
    return sys.platform in ("win32", "darwin") or any(shutil.which(name) for name in LINUX_PROGRAMS)


class FileDialogs:
    """At most one question for a path at a time; `show` is called every frame."""

    def __init__(self, folder: Path | None = None):
        self.folder = folder
        """Where the next dialog starts."""
        self._native: pfd.open_file | pfd.save_file | None = None
        self._title = ""
        self._typed: str | None = None
        self._done: Callable[[list[Path]], object] | None = None
        self._saving = False
        self._fresh = False

    @property
    def open(self) -> bool:
        return self._done is not None

    def ask(self, title: str, done: Callable[[list[Path]], object], *, kind: Kind, name: str = "") -> None:
        """Asks for files; `done` gets at least one path, or is not called where the user changed his mind.

        `name`: the file name a saving dialog proposes.
        """
        if self.open:
            return
        self._title, self._done, self._saving = title, done, kind.startswith("save")
        proposal = str((self.folder or Path.cwd()) / name) if name else str(self.folder or Path.cwd())
        if not has_native_dialogs():
            self._typed, self._fresh = (proposal if self._saving else ""), True
        elif self._saving:
            self._native = pfd.save_file(title, proposal, FILTERS[kind])
        else:
            self._native = pfd.open_file(title, proposal, FILTERS[kind], pfd.opt.multiselect)

    def show(self) -> None:
        """Polls the system's dialog or draws the plain one."""
        if self._native is not None and self._native.ready(0):
            answer = self._native.result()
            self._native = None
            self._finish([answer] if isinstance(answer, str) else answer)
        if self._typed is not None:
            self._show_plain()

    def close(self) -> None:
        """Takes a dialog that is still open away, for the program's end."""
        if self._native is not None:
            self._native.kill()

    def _show_plain(self) -> None:
        if self._fresh:
            imgui.open_popup(self._title)
        centre = imgui.get_main_viewport().get_center()
        imgui.set_next_window_pos(centre, imgui.Cond_.appearing, (0.5, 0.5))
        imgui.set_next_window_size((imgui.get_font_size() * 34, 0))
        if not imgui.begin_popup_modal(self._title, None, imgui.WindowFlags_.no_saved_settings)[0]:
            if not self._fresh:
                self._finish([])
            return
        imgui.text_wrapped("Path of the file:" if self._saving else "Path of the file, or several between ;")
        if self._fresh:
            imgui.set_keyboard_focus_here()
            self._fresh = False
        imgui.set_next_item_width(-1)
        entered, self._typed = imgui.input_text(
            "##path", self._typed or "", imgui.InputTextFlags_.enter_returns_true
        )
        accepted = imgui.button("Save" if self._saving else "Open") or entered
        imgui.same_line()
        cancelled = imgui.button("Cancel") or imgui.is_key_pressed(imgui.Key.escape)
        if accepted or cancelled:
            imgui.close_current_popup()
            names = [part.strip().strip("\"'") for part in self._typed.split(";")] if accepted else []
            self._finish([name for name in names if name])
        imgui.end_popup()

    def _finish(self, names: list[str]) -> None:
        done, self._done, self._typed = self._done, None, None
        paths = [Path(name).expanduser() for name in names if name]
        if paths and done is not None:
            self.folder = paths[0].parent
            done(paths)
