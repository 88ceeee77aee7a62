"""The form of a new training, without a window."""

from __future__ import annotations

import shutil
import time
from dataclasses import replace

import pytest
from PIL import Image

from splatview.scene import InputError
from splatview.viewer.command import Command
from splatview.viewer.commands import COMMANDS
from splatview.viewer.preferences import load_preferences, save_preferences, with_recent
from splatview.viewer.state import AppState
from splatview.viewer.training.start import AUTOMATIC, TrainingStart


def looked(app: AppState) -> TrainingStart:
    start = app.feature(TrainingStart)
    limit = time.monotonic() + 200
    while start.is_looking:
        assert time.monotonic() < limit
        start.before_frame(app)
        time.sleep(0.005)
    return start


def test_the_folder_of_the_photos_stands_for_its_capture(app, capture):
    (photos,) = {path.parent for path in capture.rglob("*.png")}
    assert photos != capture
    app.feature(TrainingStart).choose(photos)
    start = looked(app)
    assert start.problem == "" and start.folder == capture
    assert start.found is not None and len(start.found.photos) == 10


def test_the_form_bounds_the_memory_of_the_run(app, capture):
    start = app.feature(TrainingStart)
    start.choose(capture)
    assert looked(app).found is not None and "--memory" not in start.arguments()
    free = start.planned_memory()
    assert not free.bound.asked and free.splats == free.wanted
    start.form.memory = "2 GB"
    assert start.arguments()[-2:] == ["--memory", "2 GB"]
    bounded = start.planned_memory()
    assert bounded.bound.bytes == 2 * 10**9 and bounded.peak <= bounded.bound.bytes
    start.machine = replace(start.machine, left=10**8)
    start.form.memory = AUTOMATIC
    with pytest.raises(InputError, match=r"this machine has .* left for it; choose a smaller size"):
        start.planned_memory()


def test_the_form_asks_for_corrections(app, capture):
    start = app.feature(TrainingStart)
    start.choose(capture)
    assert looked(app).found is not None
    start.form.exposure, start.form.sky, start.form.background = "on", "off", "white"
    start.form.outliers, start.form.passing, start.form.shading = "off", "stay", "off"
    asked = " ".join(start.arguments())
    assert "--outliers off --passing stay" in asked
    assert "--exposure on --shading off" in asked and "--sky off" in asked and "--background 1,1,1" in asked


def test_the_form_asks_what_masks_mean_where_there_are_any(app, capture, tmp_path):
    capture = shutil.copytree(capture, tmp_path / "masked")  # others have it without
    start = app.feature(TrainingStart)
    start.choose(capture)
    found = looked(app).found
    assert found is not None and found.masks == 0 and "--masks" not in start.arguments()
    masks = capture / "masks"
    masks.mkdir()
    for photo in found.photos[:3]:
        Image.new("L", found.size, 255).save(masks / f"{photo.name}.png")
    start.choose(capture)
    found = looked(app).found
    assert found is not None and found.masks == 3
    assert "--masks ignore" in " ".join(start.arguments())
    start.form.masks = "cut-out"
    assert "--masks cut-out" in " ".join(start.arguments())


def test_a_folder_without_a_capture_above_it_is_told_of(app, tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    app.feature(TrainingStart).choose(tmp_path / "a" / "b")
    assert str(tmp_path / "a" / "b") in looked(app).problem


def test_captures_are_remembered_apart_from_scenes(app, tmp_path):
    changed = with_recent(app.preferences, tmp_path / "photos", "recent_photos")
    save_preferences(with_recent(changed, tmp_path / "scene.ply"))
    read, complaint = load_preferences()
    assert complaint is None
    assert read.recent_photos == (str(tmp_path / "photos"),) and read.recent == (str(tmp_path / "scene.ply"),)


def test_what_is_asked_for_by_name_is_shown_and_not_hidden(app):
    page, strip = COMMANDS["page_train"], COMMANDS["strip_history"]

    def by_name(command: Command) -> None:
        assert command.shows is not None
        command.shows(app)

    for _ in range(2):
        by_name(page)
        by_name(strip)
        assert (app.page, app.strip) == ("Train", "History")
    page.run(app)
    strip.run(app)
    assert (app.page, app.strip) == ("", ""), "as a click on the rail does"
