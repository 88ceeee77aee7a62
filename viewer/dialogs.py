"""Windows that open over the docks: progress, errors, the help page, saving a picture."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Literal

from imgui_bundle import ImVec4, imgui
from imgui_bundle import portable_file_dialogs as pfd

from splatview.scene.formats import name_patterns
from splatview.viewer import open as opening
from splatview.viewer import save as saving
from splatview.viewer import theme
from splatview.viewer.commands import COMMANDS, HELD_KEYS, MOUSE
from splatview.viewer.key_presets import ACTION_TEXTS, Preset
from splatview.viewer.key_presets import MOUSE as DRAGS
from splatview.viewer.panels import widgets
from splatview.viewer.panels.file_browser import FileBrowser
from splatview.viewer.state import AppState


def centred(width_em: float) -> None:
    """Puts the next window into the middle, no larger than the program's."""
    viewport = imgui.get_main_viewport()
    imgui.set_next_window_pos(viewport.get_center(), imgui.Cond_.appearing, (0.5, 0.5))
    imgui.set_next_window_size_constraints((0, 0), (viewport.size.x * 0.96, viewport.size.y * 0.9))
    imgui.set_next_window_size((imgui.get_font_size() * width_em, 0), imgui.Cond_.appearing)


DIALOG_FLAGS = (
    imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_collapse | imgui.WindowFlags_.no_saved_settings
)

LOADING_SHOWN_AFTER = 0.3
"""Seconds: what is quicker than this would only flicker."""


def loading(app: AppState) -> None:
    """Progress of the scene or another file on its way, with a button to stop it."""
    reading = app.loading or next((f.reading for f in app.features.values() if f.reading is not None), None)
    if reading is None or app.now() - reading.began < LOADING_SHOWN_AFTER:
        return
    if app.dialog == "start":  # which says so itself of the demo behind it
        return
    centred(24)
    imgui.begin("Loading", None, DIALOG_FLAGS | imgui.WindowFlags_.always_auto_resize)
    imgui.text_unformatted(f"{reading.stage} {reading.name}")
    progress = reading.progress
    share, text = (-imgui.get_time(), "") if progress < 0 else (progress, f"{progress:.0%}")
    imgui.progress_bar(share, (imgui.get_font_size() * 22, 0), text)
    widgets.command_button(app, "Cancel", "cancel")
    imgui.end()


def problem(app: AppState) -> None:
    """An error that the user is to read; the scene behind it is as it was."""
    if app.problem is None:
        return
    name = "That did not work"
    if not imgui.is_popup_open(name):
        imgui.open_popup(name)
    centred(30)
    if imgui.begin_popup_modal(name, None, DIALOG_FLAGS)[0]:
        imgui.push_text_wrap_pos(0)
        imgui.text_unformatted(app.problem)
        imgui.pop_text_wrap_pos()
        imgui.spacing()
        if imgui.button("OK", (imgui.get_font_size() * 6, 0)) or imgui.is_key_pressed(imgui.Key.enter):
            app.problem = None
            imgui.close_current_popup()
        imgui.set_item_default_focus()
        imgui.end_popup()


def recent(app: AppState) -> None:
    """The scenes that were open before, to choose from."""
    if app.dialog != "recent":
        return
    centred(30)
    opened = imgui.begin("Recent scenes", True, DIALOG_FLAGS | imgui.WindowFlags_.always_auto_resize)[1]
    if not app.preferences.recent:
        widgets.note("None yet.")
    for name in app.preferences.recent:
        if imgui.selectable(widgets.item(Path(name).name, name), False)[0]:
            app.dialog = None
            app.post(opening.open_paths, [Path(name)])
        widgets.tooltip(name)
    imgui.end()
    if not opened and app.dialog == "recent":
        app.dialog = None


HELP_COLUMNS = (
    ("Mouse", "Moving", "Navigation"),
    ("Camera", "File"),
    ("Select", "Edit", "Recipe"),
    ("Picture", "Sequence", "Film", "Window", "Training"),
)
"""Groups of commands, held keys and the mouse, column by column."""


def help_page(app: AppState) -> None:
    """All keys, from the one table that binds them."""
    if app.dialog != "help":
        return
    centred(84)
    opened = imgui.begin("Keys and mouse", True, DIALOG_FLAGS)[1]
    if imgui.begin_table("help", len(HELP_COLUMNS)):
        for column in HELP_COLUMNS:
            imgui.table_next_column()
            for group in column:
                key_table(group, help_rows(group, app.preferences.mouse))
        imgui.end_table()
    imgui.end()
    if not opened:
        app.dialog = None


def help_rows(group: str, mouse: Preset = "splatview") -> list[tuple[str, str]]:
    """Keys and what they do, of one group of the help page; drags as in the preset `mouse`."""
    if group == "Mouse":
        return [*((drag.text, ACTION_TEXTS[drag.action]) for drag in DRAGS[mouse]), *MOUSE]
    entries = HELD_KEYS if group == "Moving" else [c for c in COMMANDS.values() if c.group == group]
    return [(", ".join(entry.keys), entry.title) for entry in entries if entry.keys]


def key_table(name: str, rows: Iterable[tuple[str, str]]) -> None:
    imgui.separator_text(name)
    if imgui.begin_table(name, 2):
        imgui.table_setup_column("key", imgui.TableColumnFlags_.width_fixed, imgui.get_font_size() * 8)
        imgui.table_setup_column("text", imgui.TableColumnFlags_.width_stretch)
        for keys, text in rows:
            imgui.table_next_column()
            imgui.text_colored(ImVec4(*theme.ACCENT, 1), keys)
            imgui.table_next_column()
            imgui.push_text_wrap_pos(0)
            imgui.text_unformatted(text)
            imgui.pop_text_wrap_pos()
        imgui.end_table()


def screenshot(app: AppState) -> None:
    """Size and place of a picture to save."""
    if app.dialog != "screenshot":
        return
    centred(24)
    opened = imgui.begin("Save a picture", True, DIALOG_FLAGS | imgui.WindowFlags_.always_auto_resize)[1]
    width, height = app.screenshot_size or app.picture_size
    widgets.label("Size", "Pixels of the saved picture; the window shows its middle.")
    changed, size = imgui.input_int2("##size", [width, height])
    if changed:
        width, height = (min(max(int(side), 1), saving.MAX_SIDE) for side in size)
        app.screenshot_size = (width, height)
    for name, factor in (("As seen", 1), ("2 x", 2), ("4 x", 4)):
        if factor > 1:
            imgui.same_line()
        if imgui.button(name):
            w, h = app.picture_size
            app.screenshot_size = (min(w * factor, saving.MAX_SIDE), min(h * factor, saving.MAX_SIDE))
    imgui.spacing()
    if imgui.button("Beside the scene"):
        path = saving.next_free(saving.picture_folder(app) / f"{saving.picture_stem(app)}.png")
        app.post(saving.save_picture, saving.resized(app.camera, width, height), path)
        app.dialog = None
    imgui.same_line()
    if imgui.button("Choose a place..."):
        camera = saving.resized(app.camera, width, height)
        app.choose_files(
            "Save the picture",
            lambda paths: app.post(saving.save_picture, camera, paths[0].with_suffix(".png")),
            kind="save_picture",
            name=f"{saving.picture_stem(app)}.png",
        )
        app.dialog = None
    imgui.end()
    if not opened:
        app.dialog = None


Kind = Literal[
    "scene", "cameras", "picture", "folder", "save_picture", "save_camera", "save_scene", "recipe",
    "save_recipe", "save_film",
]  # fmt: skip

FILTERS: dict[Kind, list[str]] = {
    "scene": ["Splat scenes", name_patterns(), "All files", "*"],
    "cameras": ["Camera lists", "*.json *.bin *.txt", "All files", "*"],
    "picture": ["Pictures", "*.jpg *.jpeg *.png *.webp *.tif *.tiff *.bmp", "All files", "*"],
    "folder": ["Folders", "*"],
    "save_picture": ["PNG pictures", "*.png"],
    "save_camera": ["Cameras", "*.json"],
    "save_scene": ["Splat scenes", name_patterns(written=True)],
    "recipe": ["Recipes", "*.json", "All files", "*"],
    "save_recipe": ["Recipes", "*.json"],
    "save_film": ["Films", "*.mp4 *.webm *.gif", "All files", "*"],
}

LINUX_PROGRAMS = ("zenity", "kdialog", "qarma", "matedialog")
"""Programs that portable-file-dialogs can start on Linux; without one its dialogs never appear."""


def has_native_dialogs() -> bool:
    return sys.platform in ("win32", "darwin") or any(shutil.which(name) for name in LINUX_PROGRAMS)


class FileDialogs:
    """At most one question for a path at a time; `show` is called every frame."""

    def __init__(self, folder: Path | None = None, *, recent: Callable[[], Sequence[str]] = tuple):
        """`recent`: paths that were opened, newest first."""
        self.folder = folder
        """Where the next dialog starts."""
        self.browser: FileBrowser | None = None
        """Browser of our own, where the system has none."""
        self._recent = recent
        self._native: pfd.open_file | pfd.save_file | pfd.select_folder | None = None
        self._done: Callable[[list[Path]], object] | None = None

    @property
    def open(self) -> bool:
        return self._done is not None

    def ask(
        self,
        title: str,
        done: Callable[[list[Path]], object],
        *,
        kind: Kind,
        name: str = "",
        note: str = "",
    ) -> None:
        """Asks for files, or a folder; `done` gets at least one path, or is not called where the user changed
        his mind.

        `name`: the file name a saving dialog proposes. `note`: why it is asked, where there is room for it:
        dialogs of the system have none.
        """
        if self.open:
            return
        self._done, saving = done, kind.startswith("save")
        folder = self.folder if self.folder is not None and self.folder.is_dir() else Path.cwd()
        proposal = str(folder / name) if name else str(folder)
        if any("\ud800" <= one <= "\udfff" for one in proposal):
            proposal = name  # no dialog takes names that are no text
        if not has_native_dialogs():
            self.browser = FileBrowser(
                title,
                folder,
                saving=saving,
                folders=kind == "folder",
                name=name,
                note=note,
                filters=FILTERS[kind],
                recent=self._recent() if kind == "scene" else (),
            )
        elif kind == "folder":
            self._native = pfd.select_folder(title, proposal)
        elif saving:
            self._native = pfd.save_file(title, proposal, FILTERS[kind])
        else:
            self._native = pfd.open_file(title, proposal, FILTERS[kind], pfd.opt.multiselect)

    def show(self) -> None:
        """Polls the system's dialog or draws our own."""
        if self._native is not None and self._native.ready(0):
            answer = self._native.result()
            self._native = None
            self._finish([Path(name) for name in ([answer] if isinstance(answer, str) else answer) if name])
        if self.browser is not None:
            self.browser.show()
            if self.browser.answer is not None:
                answer, browser, self.browser = self.browser.answer, self.browser, None
                browser.close()
                self._finish(answer)

    def close(self) -> None:
        """Takes a dialog that is still open away, for the program's end."""
        if self._native is not None:
            self._native.kill()
        if self.browser is not None:
            self.browser.close()

    def _finish(self, paths: list[Path]) -> None:
        done, self._done = self._done, None
        if paths and done is not None:
            self.folder = paths[0].parent
            done(paths)
