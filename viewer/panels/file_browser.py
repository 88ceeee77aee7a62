"""A file browser for systems that have no dialog of their own: places, completion, filters, recent files."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from splatview.scene.errors import bytes_in_words, printable
from splatview.viewer import file_listing, theme
from splatview.viewer.file_listing import Entry
from splatview.viewer.panels import widgets
from splatview.viewer.tasks import LatestTask, Task

WIDTH_EM, HEIGHT_EM = 50.0, 31.0
"""Size of the browser, in font heights."""

PLACES_EM = 11.0
"""Width of the list of places."""

RECENT = "Recent files"


class FileBrowser:
    """One question for a path: a modal window that `show` draws until it has an answer."""

    def __init__(
        self,
        title: str,
        folder: Path,
        *,
        saving: bool = False,
        folders: bool = False,
        name: str = "",
        note: str = "",
        filters: Sequence[str] = ("All files", "*"),
        recent: Sequence[str] = (),
    ):
        """`saving`: asks for a file to write, proposing `name`; `folders`: for a folder; `note`: why it is
        asked. `filters` are labels and file name patterns in turn, as file dialogs want them; `recent` paths,
        newest first."""
        self.title, self.folder, self.saving, self.folders = title, folder, saving, folders
        self.filters = list(zip(filters[::2], (line.split() for line in filters[1::2]), strict=True))
        self.filter = 0
        """Index of the one in force."""
        self.text = name if saving else ""
        """What is typed: a name in `folder`, or a path."""
        self.recent = tuple(recent)
        self.shows_recent = False
        """Whether recent files are listed in the place of a folder."""
        self.note = note
        self.problem = ""
        """Why the last answer was none."""
        self.answer: list[Path] | None = None
        """Chosen paths; empty where the user changed his mind, None while he has not decided."""
        self.chosen: set[Path] = set()
        """Rows that are highlighted."""
        self._places = file_listing.places(recent)
        self._listing: LatestTask[Path, list[Entry]] = LatestTask(_list, name="splatview-folder")
        self._listed = folder
        """Folder that is shown: `folder`, or that of a typed path."""
        self._followed: tuple[str, Path] | None = None
        self._typed = ""
        """What rows are narrowed down by: typed, not clicked."""
        self._row = -1
        """Row that the arrow keys are at."""
        self._fresh = True
        self._focus = True
        self._edit: str | None = None
        """Text for the field that is being typed in."""
        self._over: Path | None = None
        """File that exists, and that the user was asked about."""

    def show(self) -> None:
        """Draws it; `answer` says when it is over."""
        if self._fresh:
            imgui.open_popup(self.title)
            self._fresh = False
        viewport, em = imgui.get_main_viewport(), imgui.get_font_size()
        size = ImVec2(min(WIDTH_EM * em, viewport.size.x * 0.94), min(HEIGHT_EM * em, viewport.size.y * 0.9))
        imgui.set_next_window_pos(viewport.get_center(), imgui.Cond_.appearing, (0.5, 0.5))
        imgui.set_next_window_size(size, imgui.Cond_.appearing)
        flags = imgui.WindowFlags_.no_saved_settings | imgui.WindowFlags_.no_collapse
        shown, opened = imgui.begin_popup_modal(self.title, True, flags)
        if not shown:
            self.answer = self.answer or []
            return
        self._follow_typing()
        if self.note:
            widgets.note(self.note)
        self._path_row()
        foot = 2 * imgui.get_frame_height_with_spacing() + imgui.get_style().item_spacing.y
        height = max(imgui.get_content_region_avail().y - foot, 4 * em)
        self._place_list(ImVec2(PLACES_EM * em, height))
        imgui.same_line()
        self._table(self._rows(), ImVec2(0, height))
        self._foot()
        if not opened or imgui.is_key_pressed(imgui.Key.escape):
            self.answer = []
        if self.answer is not None:
            imgui.close_current_popup()
        imgui.end_popup()

    def close(self) -> None:
        self._listing.close()

    def _follow_typing(self) -> None:
        """The listed folder is that of the typed path, where there is one."""
        key = self.text, self.folder
        if key != self._followed:
            self._followed = key
            where = file_listing.split(*key)[0]
            if where != self.folder:
                self.shows_recent = False
            self._listed = where if where.is_dir() else self.folder
        self._listing.request(self._listed)

    def _rows(self) -> list[Entry]:
        if self.shows_recent:
            entries = file_listing.entries_of(self.recent)
        else:
            entries = self._listing.latest or [] if self._listing.has_tried(self._listed) else []
            if entries and entries[0].path.parent != self._listed:  # those of the folder before
                entries = []
        return file_listing.matching(
            entries, self.filters[self.filter][1], self._typed, folders_only=self.folders
        )

    def _path_row(self) -> None:
        if imgui.button(icons.ICON_FA_ARROW_UP):
            self._enter(self._listed.parent)
        widgets.tooltip("The folder above.")
        imgui.same_line()
        where = RECENT if self.shows_recent else printable(str(self._listed))
        imgui.align_text_to_frame_padding()
        room = imgui.get_content_region_avail().x
        imgui.text_unformatted(_shortened(where, room))
        widgets.tooltip(where)
        if self._focus:
            imgui.set_keyboard_focus_here()
            self._focus = False
        imgui.set_next_item_width(-1)
        hint = "Name" if self.saving else "Name or path; Tab completes"
        entered, text = imgui.input_text_with_hint(
            "##path",
            hint,
            self.text,
            imgui.InputTextFlags_.enter_returns_true
            | imgui.InputTextFlags_.callback_completion
            | imgui.InputTextFlags_.callback_always,
            self._in_field,
        )
        if text != self.text:
            self.text = text
            self._typed = "" if self.saving else file_listing.split(text, self.folder)[1]
            self._row, self.problem, self._over = -1, "", None
            self.chosen.clear()
        if entered:
            self._accept()

    def _in_field(self, data: imgui.InputTextCallbackData) -> int:
        """While the field is typed in: completes, and takes over what was set otherwise."""
        if data.event_flag == imgui.InputTextFlags_.callback_completion:
            entries = self._listing.latest or []
            shown = file_listing.matching(
                entries, self.filters[self.filter][1], folders_only=self.folders
            ) or list(entries)
            self._edit = file_listing.completed(str(data.buf), self.folder, shown)
        if self._edit is not None:
            data.delete_chars(0, data.buf_text_len)
            data.insert_chars(0, self._edit)
            data.clear_selection()
            self._edit = None
        return 0

    def _put(self, text: str) -> None:
        """Sets the field's text, also while it is typed in."""
        self.text, self._edit = text, text

    def _place_list(self, size: ImVec2) -> None:
        imgui.begin_child("##places", size, imgui.ChildFlags_.frame_style)
        if self.recent and imgui.selectable(RECENT, self.shows_recent)[0]:
            self.shows_recent = True
        for label, folder in self._places:
            here = folder == self._listed and not self.shows_recent
            if imgui.selectable(widgets.item(label, folder), here)[0]:
                self._enter(folder)
            widgets.tooltip(str(folder))
        imgui.end_child()

    def _table(self, rows: Sequence[Entry], size: ImVec2) -> None:
        self._arrows(rows)
        flags = imgui.TableFlags_.scroll_y | imgui.TableFlags_.row_bg | imgui.TableFlags_.borders_outer
        if not imgui.begin_table("##files", 3, flags, size):
            return
        em = imgui.get_font_size()
        imgui.table_setup_scroll_freeze(0, 1)
        imgui.table_setup_column("Name", imgui.TableColumnFlags_.width_stretch)
        imgui.table_setup_column("Size", imgui.TableColumnFlags_.width_fixed, 5.5 * em)
        imgui.table_setup_column("Changed", imgui.TableColumnFlags_.width_fixed, 8.5 * em)
        imgui.table_headers_row()
        clipper = imgui.ListClipper()
        clipper.begin(len(rows))
        while clipper.step():
            for number in range(clipper.display_start, clipper.display_end):
                self._table_row(number, rows[number])
        if not rows:
            imgui.table_next_row()
            imgui.table_next_column()
            imgui.text_colored(theme.QUIET, self._why_empty())
        imgui.end_table()

    def _why_empty(self) -> str:
        if self._listing.problem is not None and not self.shows_recent:
            return self._listing.problem
        if self._listing.busy:
            return "Reading..."
        return "Nothing here has this name" if self._typed else "Nothing of this kind here"

    def _arrows(self, rows: Sequence[Entry]) -> None:
        down, up = (imgui.is_key_pressed(key) for key in (imgui.Key.down_arrow, imgui.Key.up_arrow))
        if (down or up) and rows:
            self._row = min(max(self._row + down - up, 0), len(rows) - 1)
            self.chosen = {rows[self._row].path}

    def _table_row(self, number: int, entry: Entry) -> None:
        imgui.table_next_row()
        imgui.table_next_column()
        icon = icons.ICON_FA_FOLDER if entry.is_folder else icons.ICON_FA_CUBE
        imgui.text_colored(theme.QUIET, icon)
        imgui.same_line(imgui.get_font_size() * 1.7)
        flags = (
            imgui.SelectableFlags_.span_all_columns
            | imgui.SelectableFlags_.allow_double_click
            | imgui.SelectableFlags_.no_auto_close_popups
        )
        name = str(entry.path) if self.shows_recent else entry.name
        if imgui.selectable(widgets.item(name, number), entry.path in self.chosen, flags)[0]:
            self._clicked(entry)
        imgui.table_next_column()
        imgui.text_colored(theme.QUIET, "" if entry.is_folder else bytes_in_words(entry.size))
        imgui.table_next_column()
        imgui.text_colored(theme.QUIET, _day(entry.modified))

    def _clicked(self, entry: Entry) -> None:
        self.problem, self._over, self._row = "", None, -1
        if imgui.is_mouse_double_clicked(0):
            if entry.is_folder and not (self.folders and self.shows_recent):
                self._enter(entry.path)
            else:
                self._take([entry.path])
            return
        self.folder = self._listed
        several = imgui.get_io().key_ctrl and not self.saving and not self.folders
        self.chosen = self.chosen ^ {entry.path} if several else {entry.path}
        if entry.is_folder and not self.folders:
            return
        files = sorted(self.chosen)
        names = [str(path) if path.parent != self.folder else path.name for path in files]
        self._put(f" {file_listing.LIST} ".join(names))

    def _enter(self, folder: Path) -> None:
        self.folder, self.shows_recent = folder, False
        self.chosen.clear()
        self._row, self._typed, self.problem = -1, "", ""
        self._focus = True
        if not self.saving:
            self._put("")

    def _foot(self) -> None:
        em = imgui.get_font_size()
        if self.problem:
            imgui.text_colored(theme.WARNING, _shortened(self.problem, imgui.get_content_region_avail().x))
        else:
            imgui.text_colored(theme.QUIET, self._hint())
        if len(self.filters) > 1:
            imgui.set_next_item_width(14 * em)
            changed, index = imgui.combo("##filter", self.filter, [label for label, _ in self.filters])
            if changed:
                self.filter = index
            widgets.tooltip(" ".join(self.filters[self.filter][1]))
            imgui.same_line()
        verb = "Save" if self.saving else "Choose" if self.folders else "Open"
        if self._over is not None:
            verb = "Replace"
        width = 7 * em
        room = imgui.get_content_region_avail().x - 2 * width - imgui.get_style().item_spacing.x
        imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(room, 0.0))
        if imgui.button(f"{verb}###accept", (width, 0)):
            self._accept()
        imgui.same_line()
        if imgui.button("Cancel", (width, 0)):
            self.answer = []

    def _hint(self) -> str:
        if self.folders:
            return "A double click opens a folder; Choose takes the one that is listed or named"
        return "" if self.saving else "Ctrl + click chooses several"

    def _accept(self) -> None:
        """The answer, where it can be one; a folder is entered."""
        if self._row >= 0 and self.chosen:
            self._take(sorted(self.chosen))
        elif self.text.strip():
            self._take(file_listing.typed_paths(self.text, self.folder))
        elif self.folders:
            self._take([self._listed])
        elif self.chosen:
            self._take(sorted(self.chosen))

    def _take(self, paths: list[Path]) -> None:
        self._focus = True  # the field has let go of the keyboard
        if len(paths) == 1 and paths[0].is_dir() and not self.folders:
            self._enter(paths[0].resolve())
            return
        missing = [path for path in paths if not os.path.lexists(path)]
        if self.saving:
            self._take_new(paths[0])
        elif missing:
            self.problem = f"{printable(str(missing[0]))}: there is no such file"
        elif self.folders and not paths[0].is_dir():
            self.problem = f"{printable(paths[0].name)} is a file; a folder is asked for"
        else:
            self.answer = [Path(os.path.normpath(path)) for path in paths]

    def _take_new(self, path: Path) -> None:
        if not path.parent.is_dir():
            self.problem = f"{printable(str(path.parent))}: there is no such folder"
        elif os.path.lexists(path) and self._over != path:
            self._over = path
            self.problem = f"{printable(path.name)} exists; Replace writes over it"
        else:
            self.answer = [Path(os.path.normpath(path))]


def _list(folder: Path, _: Task[list[Entry]]) -> list[Entry]:
    return file_listing.listed(folder)


def _day(seconds: float) -> str:
    """The date, with the time where it is of this year."""
    if not seconds:
        return ""
    then, now = time.localtime(seconds), time.localtime()
    return time.strftime("%d %b %H:%M" if then.tm_year == now.tm_year else "%d %b %Y", then)


def _shortened(text: str, room: float, measure: Callable[[str], ImVec2] = imgui.calc_text_size) -> str:
    """`text`, without its beginning where it is wider than `room`."""
    if measure(text).x <= room:
        return text
    kept = len(text)
    while kept > 1 and measure("..." + text[-kept:]).x > room:
        kept -= max(kept // 16, 1)
    return "..." + text[-kept:]
