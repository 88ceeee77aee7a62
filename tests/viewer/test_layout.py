"""Where the parts of the window are, and what its state says about them."""

from __future__ import annotations

from itertools import combinations

import pytest

from splatview.viewer.commands import COMMANDS
from splatview.viewer.layout import PAGES, STRIP, Rectangle, available, open_panel, places
from splatview.viewer.preferences import Preferences, load_preferences
from splatview.viewer.state import Rate
from splatview.viewer.status_bar import brief


def overlap(a: Rectangle, b: Rectangle) -> bool:
    x = min(a.x + a.width, b.x + b.width) - max(a.x, b.x)
    y = min(a.y + a.height, b.y + b.height) - max(a.y, b.y)
    return x > 0 and y > 0


@pytest.mark.parametrize("size", [(1600, 976), (1024, 616), (512, 300)])
@pytest.mark.parametrize("inspector", [0.0, 20.0, 60.0])
@pytest.mark.parametrize("strip", [0.0, 12.0, 60.0])
def test_the_parts_fill_the_window_without_overlapping(size, inspector, strip):
    area = Rectangle(0, 24, *size)
    found = places(area, 16, inspector=inspector, strip=strip, rail=True)
    parts = [part for part in vars(found).values() if part is not None]
    assert len(parts) == 3 + (inspector > 0) + (strip > 0)
    assert not any(overlap(a, b) for a, b in combinations(parts, 2))
    assert sum(part.width * part.height for part in parts) == size[0] * size[1]
    assert found.view.width >= min(12 * 16, size[0] - round(16 * 4.4) - 17 * 16)


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (0, "0"),
        (999, "999"),
        (1000, "1.0k"),
        (9949, "9.9k"),
        (9950, "10k"),
        (512_345, "512k"),
        (999_500, "1.0M"),
        (12_000_000, "12M"),
    ],
)
def test_counts_of_a_narrow_status_bar(count, text):
    assert brief(count) == text


def test_the_picture_alone_has_all_but_the_status_bar():
    found = places(Rectangle(0, 24, 800, 476), 16, inspector=0, strip=0, rail=False)
    assert (found.view.width, found.view.height) == (800, 476 - found.status.height)
    assert found.rail is None and found.inspector is None and found.strip is None


def test_pages_are_opened_shut_and_kept(app):
    COMMANDS["page_view"].run(app)
    assert app.page == "View" == app.preferences.page and COMMANDS["page_view"].checked(app)
    COMMANDS["page_view"].run(app)
    assert app.page == "" and open_panel(app, PAGES, app.page) is None
    COMMANDS["section_effects"].run(app)
    assert (app.page, app.reveal) == ("Accuracy", "Effects")
    COMMANDS["strip_log"].run(app)
    COMMANDS["toggle_panels"].run(app)
    assert open_panel(app, STRIP, app.strip) is None, "only the picture"
    COMMANDS["strip_log"].run(app)
    assert app.strip == "Log" and not app.panels_hidden
    COMMANDS["reset_panels"].run(app)
    new = Preferences()
    assert (app.page, app.strip, app.preferences.strip) == (new.page, new.strip, new.strip)


def test_panels_of_a_training_are_there_in_one_only(app):
    assert [panel.name for panel in available(app, STRIP)] == ["History", "Film", "Log"]
    app.strip = "Curves"
    assert open_panel(app, STRIP, app.strip) is None


def test_preferences_of_the_docked_layout_are_read(tmp_path, monkeypatch):
    monkeypatch.setenv("SPLATVIEW_CONFIG_DIR", str(tmp_path))
    (tmp_path / "preferences.json").write_text('{"closed_panels": ["Views"], "fly_speed": 2.0}')
    preferences, complaint = load_preferences()
    assert complaint is None and preferences.fly_speed == 2.0 and preferences.page == "Scene"


def test_the_rate_is_of_pictures_that_were_drawn():
    rate = Rate()
    found = [rate.at(0.1 * step, step // 2) for step in range(21)]
    assert found[0] is None and found[-1] == pytest.approx(5.0)
    assert rate.at(2.4, 10) == pytest.approx(5.0)
    assert rate.at(9.0, 10) is None, "at rest"
