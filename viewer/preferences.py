"""Preferences, one JSON file in the user's configuration folder; bookmarks, one beside each scene."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from splatview.scene import InputError
from splatview.scene.formats.cameras import is_orthographic, lens_of
from splatview.scene.formats.io import atomic_write, read_json
from splatview.scene.user_dirs import config_folder
from splatview.viewer.key_presets import PRESETS, Preset
from splatview.viewer.navigation import Lens, View
from splatview.viewer.navigation.view import MAX_FOV, MIN_FOV, orthonormal, unit

NavigationMode = Literal["orbit", "fly", "trackball"]
BackgroundKind = Literal["colour", "gradient", "panorama"]
BlendPrecision = Literal["float16", "float32"]
TrainingUpdates = Literal["off", "low", "live"]
PlayMode = Literal["loop", "bounce", "once"]
Theme = Literal["dark", "light", "contrast"]
Recent = Literal["recent", "recent_photos"]

FILE_NAME = "preferences.json"
MAX_RECENT = 12
"""As many as fit a menu without scrolling."""


@dataclass(frozen=True, kw_only=True)
class Preferences:
    """Equal in meaning on every machine: nothing here names a window position or a GPU."""

    navigation: NavigationMode = "orbit"
    fly_speed: float = 1.0
    """Factor on the speed that suits the scene's size."""
    mouse_speed: float = 1.0
    invert_wheel: bool = False
    smooth: bool = True
    """Whether jumps are shown as short motions."""
    fov_y: float = 50.0
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    background_kind: BackgroundKind = "colour"
    sky: tuple[float, float, float] = (0.35, 0.53, 0.78)
    """Colour of a gradient straight up."""
    ground: tuple[float, float, float] = (0.16, 0.15, 0.14)
    """Colour of a gradient straight down."""
    panorama: str = ""
    """Absolute path of an equirectangular picture."""
    blend: BlendPrecision = "float16"
    resolution_scale: float = 1.0
    frame_budget_ms: float = 33.0
    """Budget of a frame in ms while the camera moves, where one is held."""
    show_grid: bool = False
    """Whether the ground is drawn as a grid."""
    show_axes: bool = False
    """Whether the world's axes are drawn."""
    show_cameras: bool = False
    """Whether loaded cameras are drawn into the view."""
    show_photos: bool = True
    """Whether the cameras of the photos in training are drawn into the view."""
    training_share: float = 0.5
    """Share of the cores for training while the view is moved."""
    training_takes_idle_cores: bool = True
    """Whether training takes all cores while the view is not moved."""
    training_updates: TrainingUpdates = "live"
    """How often the growing scene is shown."""
    edit_memory_gib: float = 0.0
    """Memory for edits and undo beyond the open scene; 0: half of what is free when it is opened."""
    frame_rate: float = 30.0
    """Frames a second at which sequences play."""
    play_mode: PlayMode = "loop"
    """Behaviour at the last frame of a sequence: on from the first, back, or an end."""
    sequence_memory_gib: float = 0.0
    """Memory for the frames of a sequence; 0: a quarter of what is free when it is opened."""
    page: str = "Scene"
    """Page of the inspector that is open; "" for none."""
    strip: str = ""
    """Panel of the bottom strip that is open; "" for none."""
    inspector_width: float = 20.0
    """Font heights, without the rail."""
    strip_height: float = 12.0
    """Font heights."""
    theme: Theme = "dark"
    font_size: float = 16.0
    """Height of the font on a screen of 96 dpi, px."""
    keys: Preset = "splatview"
    """Program whose keys are used."""
    mouse: Preset = "splatview"
    """Program whose drags are used."""
    touchpad: bool = False
    """Whether two fingers turn the view, instead of going nearer and farther."""
    start_screen: bool = True
    """Whether a window without a scene begins with the start screen."""
    recent: tuple[str, ...] = ()
    """Absolute paths, newest first."""
    recent_photos: tuple[str, ...] = ()
    """The same of captures that were trained on."""


RECENT: tuple[Recent, ...] = get_args(Recent)
"""Preferences that are lists of paths."""

RANGES = {
    "fly_speed": (0.01, 100.0),
    "mouse_speed": (0.1, 10.0),
    "fov_y": (5.0, 140.0),
    "font_size": (11.0, 32.0),
    "resolution_scale": (0.125, 2.0),
    "frame_budget_ms": (4.0, 200.0),
    "edit_memory_gib": (0.0, 1024.0),
    "frame_rate": (0.1, 240.0),
    "sequence_memory_gib": (0.0, 1024.0),
    "inspector_width": (17.0, 60.0),
    "strip_height": (6.0, 60.0),
    "training_share": (0.05, 1.0),
}
"""Inclusive limits of the numbers; the panels' sliders read them too."""

CHOICES = {
    "navigation": get_args(NavigationMode),
    "background_kind": get_args(BackgroundKind),
    "blend": get_args(BlendPrecision),
    "training_updates": get_args(TrainingUpdates),
    "play_mode": get_args(PlayMode),
    "theme": get_args(Theme),
    "keys": PRESETS,
    "mouse": PRESETS,
}
"""Values of the fields that are one of a few words."""

COLOURS = ("background", "sky", "ground")


def load_preferences() -> tuple[Preferences, str | None]:
    """The saved preferences, and one line to show the user where something was wrong with the file.

    A file that is no JSON object is renamed to preferences.json.broken; single values that make no
    sense, a later version's say, are replaced by their defaults. Never raises.
    """
    path = config_folder() / FILE_NAME
    if not os.path.isfile(path):
        return Preferences(), None
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        return Preferences(), f"Cannot read {path}: {error.strerror}. Defaults are used."
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict):
        aside = path.with_name(FILE_NAME + ".broken")
        try:
            os.replace(path, aside)
        except OSError as error:
            return Preferences(), f"{path} is broken and cannot be set aside: {error.strerror}."
        return Preferences(), f"{path} was broken: it is now {aside.name}, and defaults are used."
    defaults = Preferences()
    kept, wrong = {}, []
    for item in fields(Preferences):
        if item.name not in data:
            continue
        try:
            kept[item.name] = checked(item.name, data[item.name], getattr(defaults, item.name))
        except ValueError:
            wrong.append(item.name)
    line = f"{path}: ignored what is not valid in {', '.join(wrong)}." if wrong else None
    return replace(defaults, **kept), line


def checked(name: str, value: Any, default: Any) -> Any:
    """`value` of a JSON file as the field `name` needs it; ValueError where it cannot be."""
    choices = CHOICES.get(name)
    if choices is not None:
        if value not in choices:
            raise ValueError(name)
        return value
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise ValueError(name)
        return value
    if isinstance(default, float):
        low, high = RANGES[name]
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
            raise ValueError(name)
        return float(value)
    if isinstance(default, str):
        if not isinstance(value, str):
            raise ValueError(name)
        return value
    if name in COLOURS:
        if not isinstance(value, list) or len(value) != 3:
            raise ValueError(name)
        if not all(isinstance(v, (int, float)) and 0 <= v <= 1 for v in value):
            raise ValueError(name)
        return tuple(float(v) for v in value)
    if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
        raise ValueError(name)
    return tuple(value[:MAX_RECENT] if name in RECENT else value)


def save_preferences(preferences: Preferences) -> None:
    """Writes the file whole or not at all.

    Raises:
        InputError: the folder cannot be written to.
    """
    write_json(config_folder() / FILE_NAME, asdict(preferences))


def write_json(path: Path, data: Any) -> None:
    """Writes `data` as JSON, whole or not at all, into a folder that is made.

    Raises:
        InputError: the folder cannot be made or written to.
    """
    text = json.dumps(data, indent=2, allow_nan=False) + "\n"
    with contextlib.suppress(OSError):  # writing tells why
        path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        file.write(text.encode())


def with_recent(preferences: Preferences, path: Path, which: Recent = "recent") -> Preferences:
    """`path` as the newest of the recent files, or captures, once."""
    newest = str(path.absolute())
    others = [entry for entry in getattr(preferences, which) if entry != newest]
    return replace(preferences, **{which: (newest, *others)[:MAX_RECENT]})


def without_missing(preferences: Preferences) -> Preferences:
    """The recent files that still exist."""
    return replace(preferences, recent=tuple(name for name in preferences.recent if os.path.exists(name)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Bookmark:
    name: str
    view: View
    entry: str = ""
    """The text that it was read from, which tells it from others of its name; none for a new one."""


def beside(scene: Path) -> Path:
    """Where the bookmarks of `scene` belong."""
    return scene.with_name(scene.name + ".bookmarks.json")


def in_config(scene: Path) -> Path:
    """Where they go if the scene's folder cannot be written to; told apart by the scene's full path."""
    digest = hashlib.sha256(os.fsencode(scene.absolute())).hexdigest()[:12]
    name = scene.name if len(os.fsencode(scene.name)) <= 200 else scene.name[:50]
    return config_folder() / "bookmarks" / f"{name}.{digest}.bookmarks.json"


def load_bookmarks(scene: Path) -> list[Bookmark]:
    """The bookmarks of a scene; none where there is no file. Those beside the scene come first.

    Raises:
        InputError: a file cannot be read or is no list of bookmarks.
    """
    found = []
    for path in (beside(scene), in_config(scene)):
        if not os.path.lexists(path):  # or its name is too long for a file
            continue
        data = read_json(path, what="bookmarks file")
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                found += [_bookmark(entry) for entry in data["bookmarks"]]
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise InputError(f"{path}: not a bookmarks file ({error}); move it away to start anew") from None
    return found


def save_bookmarks(scene: Path, bookmarks: list[Bookmark]) -> Path:
    """Writes them beside the scene or, where that is not allowed, in the configuration folder.

    Returns:
        The file that now holds them all.

    Raises:
        InputError: neither place can be written to.
    """
    data = {"version": 1, "bookmarks": [_as_json(bookmark) for bookmark in bookmarks]}
    try:
        write_json(beside(scene), data)
    except InputError:
        write_json(in_config(scene), data)
        return in_config(scene)
    # What an earlier run had to put elsewhere is now here: it must not come back twice.
    with contextlib.suppress(OSError):
        in_config(scene).unlink()
    return beside(scene)


def _as_json(bookmark: Bookmark) -> dict[str, Any]:
    return {"name": bookmark.name, **view_to_json(bookmark.view)}


def view_to_json(view: View) -> dict[str, Any]:
    """The numbers of a view, as files of bookmarks have them."""
    return {
        "target": view.target.tolist(),
        "distance": view.distance,
        "rotation": view.R_camera_world.tolist(),
        "up": view.up.tolist(),
        "fov_y": view.lens.fov_y,
        "shift": list(view.lens.shift),
        "squeeze": view.lens.squeeze,
        **_rays(view.lens),
    }


def _rays(lens: Lens) -> dict[str, Any]:
    """Fields of lenses that are no pinholes, in the form of camera files."""
    values: dict[str, Any] = {}
    if lens.distortion is not None:
        values["lens"] = {"model": lens.distortion.model, "parameters": list(lens.distortion.parameters)}
    if lens.orthographic:
        values["orthographic"] = True
    return values


def _bookmark(entry: dict[str, Any]) -> Bookmark:
    """Raises ValueError, KeyError or TypeError where `entry` is no bookmark."""
    view = view_from_json(entry, "a bookmark")
    return Bookmark(name=str(entry["name"]), entry=json.dumps(entry, sort_keys=True), view=view)


def view_from_json(entry: dict[str, Any], where: str) -> View:
    """The view of `view_to_json`'s numbers. Raises ValueError, KeyError or TypeError where they are none;
    `where` names what they are of."""
    target, rotation = np.array(entry["target"], np.float64), np.array(entry["rotation"], np.float64)
    distance, fov_y, squeeze = (float(entry[name]) for name in ("distance", "fov_y", "squeeze"))
    x, y = entry["shift"]
    if target.shape != (3,) or rotation.shape != (3, 3):
        raise ValueError("a target or rotation has the wrong shape")
    if not np.isfinite([*target, *rotation.ravel(), distance, float(x), float(y), squeeze]).all():
        raise ValueError("a number is not finite")
    if not (distance > 0 and squeeze > 0 and MIN_FOV <= fov_y <= MAX_FOV):
        raise ValueError("a distance or field of view is out of range")
    # Large entries first, whose products overflow.
    if not (
        (abs(rotation) <= 2).all()
        and (abs(rotation @ rotation.T - np.eye(3)) <= 1e-3).all()
        and np.linalg.det(rotation) > 0
    ):
        raise ValueError("a rotation is not one")
    return View(
        target=target,
        distance=distance,
        R_camera_world=orthonormal(rotation),
        up=unit(np.array(entry["up"], np.float64).reshape(3)),
        lens=Lens(
            fov_y=fov_y,
            shift=(float(x), float(y)),
            squeeze=squeeze,
            distortion=lens_of(entry, where),
            orthographic=is_orthographic(entry, where),
        ),
    )
