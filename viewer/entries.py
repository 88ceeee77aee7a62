"""Entries of the table of commands that open a part of the window, pages, their sections, the strip; and
those of the film."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from splatview.viewer import film, save
from splatview.viewer.command import Command, needs
from splatview.viewer.editing.session import session_of
from splatview.viewer.film import Film
from splatview.viewer.preferences import Preferences
from splatview.viewer.state import AppState
from splatview.viewer.training.live import LiveTraining


@dataclass(frozen=True, kw_only=True)
class Panel:
    """A page of the inspector, or a panel of the bottom strip."""

    name: str
    """What the user reads, and the preferences keep."""
    window: str
    """ImGui's name of it."""
    icon: str
    show: Callable[[AppState], None]
    training: bool = False
    """Whether it is there only while a scene is in training."""


def arrange(app: AppState, *, page: str | None = None, strip: str | None = None) -> None:
    """Opens another page or panel of the strip, or closes it where it is "". A window that trains begins with
    those of the training, and other windows with those that were open last."""
    app.page = app.page if page is None else page
    app.strip = app.strip if strip is None else strip
    if app.find(LiveTraining) is None:
        app.prefer(page=app.page, strip=app.strip)


def open_page(app: AppState, page: str, section: str = "") -> None:
    """Opens a page of the inspector, at a section of it."""
    app.panels_hidden = False
    arrange(app, page=page)
    session = session_of(app)
    if page == "Edit" and session is not None and section:
        session.forms.open_section = section
    else:
        app.reveal = section


def toggle_page(app: AppState, page: str) -> None:
    """Opens a page of the inspector, or closes the inspector where it is the open one."""
    if app.page == page and not app.panels_hidden:
        arrange(app, page="")
    else:
        open_page(app, page)


def toggle_strip(app: AppState, name: str) -> None:
    """Opens a panel of the bottom strip, or closes the strip where it is the open one."""
    shown = app.strip == name and not app.panels_hidden
    app.panels_hidden = False
    arrange(app, strip="" if shown else name)


def show_strip(app: AppState, name: str) -> None:
    app.panels_hidden = False
    arrange(app, strip=name)


def toggle_panels(app: AppState) -> None:
    app.panels_hidden = not app.panels_hidden


def reset_panels(app: AppState) -> None:
    """The inspector and the strip as they are in a new window."""
    new = Preferences()
    app.panels_hidden = False
    arrange(app, page=new.page, strip=new.strip)
    app.prefer(inspector_width=new.inspector_width, strip_height=new.strip_height)


def _page(name: str, title: str, *words: str) -> Command:
    return Command(
        id=f"page_{name.lower()}",
        title=f"{name}: {title}",
        group="Window",
        run=partial(toggle_page, page=name),
        shows=partial(open_page, page=name),
        menu=name,
        words=words,
        checked=lambda app: app.page == name and not app.panels_hidden,
    )


def _strip(name: str, title: str, *words: str, lacks: Callable[[AppState], str] = lambda app: "") -> Command:
    return Command(
        id=f"strip_{name.lower()}",
        title=f"{name}: {title}",
        group="Window",
        run=partial(toggle_strip, name=name),
        shows=partial(show_strip, name=name),
        menu=name,
        words=words,
        lacks=lacks,
        checked=lambda app: app.strip == name and not app.panels_hidden,
    )


def _section(page: str, id: str, section: str, title: str, *words: str) -> Command:
    """Opens a page of the inspector at one of its sections."""
    return Command(
        id=f"section_{id}",
        title=title,
        group=page,
        run=partial(open_page, page=page, section=section),
        words=words,
    )


_in_training = needs(lambda app: app.find(LiveTraining) is not None, "No scene is in training in this window")

_scene, _edit, _view, _accuracy = (partial(_section, page) for page in ("Scene", "Edit", "View", "Accuracy"))

# fmt: off
ENTRIES = (
    _page("Scene", "files, crops, cameras, problems", "files", "layers", "outliner"),
    _page("Edit", "select, clean up, crop, transform, colours", "edit panel"),
    _page("View", "mode, background, camera, lens, resolution", "view settings", "display"),
    _page("Accuracy", "what each approximation saves and costs in this view", "quality", "error", "psnr",
        "pareto", "ladder"),
    _page("Train", "a scene from photos", "train", "training", "photos", "photogrammetry", "recipe"),
    _scene("files", "Files", "Files of the scene: show, lock, move or remove each", "scene manager",
        "objects", "file list"),
    _scene("problems", "Problems", "Problems of the scene: select and repair", "repair", "invalid", "health"),
    _scene("cameras", "Cameras", "Cameras that are loaded", "camera list", "colmap"),
    _view("bookmarks", "Bookmarks", "Bookmarks: views that were kept", "saved views"),
    _edit("select", "Select", "Select by range: histogram of an attribute", "histogram", "attribute",
        "range", "distribution"),
    _edit("clean", "Clean up", "Clean up: prune floaters, needles and others", "prune", "clean", "cleanup",
        "noise", "outliers"),
    _edit("decimate", "Clean up", "Decimate: keep the splats that matter most", "simplify", "reduce",
        "fewer splats", "lod"),
    _edit("crop", "Crop", "Crops: boxes and spheres by numbers", "crop list"),
    _edit("transform", "Transform", "Transform: position, rotation, scale by numbers", "upright", "orient"),
    _edit("colour", "Colour & opacity", "Colour & opacity: brightness, contrast, saturation", "colour grade",
        "color grade", "grading", "brightness", "exposure", "contrast", "saturation", "temperature", "tint",
        "levels", "opacity", "transparency", "alpha", "color", "colour", "look"),
    _view("mode", "Picture", "Visual mode: splats, points, ellipsoids, depth", "mode", "shading"),
    _view("sh_degree", "Picture", "SH degree: bands of view-dependent colour", "sh", "bands",
        "spherical harmonics"),
    _view("resolution", "Picture", "Resolution of the picture in the window", "supersampling"),
    _view("background", "Background", "Background: colour, gradient or panorama", "environment", "sky",
        "skybox", "hdri"),
    _view("navigation", "Navigation", "Navigation settings: mouse, wheel, flying speed", "mouse",
        "sensitivity", "speed", "wheel", "invert wheel"),
    _view("lens", "Lens", "Lens: field of view, orthographic, depth of field", "fisheye", "distortion",
        "fov", "field of view", "focal length"),
    _view("aperture", "Lens", "Aperture of the depth of field", "bokeh", "f-stop"),
    _view("model", "Advanced", "Image model: antialiasing, blur, near plane", "antialiasing", "mip",
        "near plane", "footprint", "discs", "2dgs"),
    _view("statistics", "Statistics", "Statistics: fps, time by stage, memory", "stats", "fps",
        "frame rate", "frames a second", "memory", "performance", "gpu"),
    _accuracy("frame_limit", "Frame limit", "Frame limit while the camera moves", "frame budget", "lag",
        "slow", "30 fps"),
    _accuracy("compare", "Compare", "Compare: split view of the exact and the fast picture", "split view",
        "side by side", "difference", "flip", "before after"),
    _accuracy("effects", "Effects", "Effects: what is computed for this scene, and why", "receipt"),
    _strip("History", "every step of editing", "steps", "undo history"),
    _strip("Curves", "loss, PSNR and splats of the training", "loss", "plots", "graph", lacks=_in_training),
    _strip("Compare", "photo, scene and their difference", "photo comparison", lacks=_in_training),
    _strip("Film", "keyframes of a camera path, played and exported", "camera path", "animation",
        "fly through", "flythrough", "camera animation"),
    _strip("Log", "what the window has said", "messages", "console", "errors"),
)
# fmt: on
"""In the order of the palette."""


_a_scene = needs(lambda app: app.is_open, "Open a scene first")
_a_path = needs(lambda app: app.feature(Film).path is not None, "Add keyframes first")
_a_choice = needs(lambda app: app.feature(Film).chosen >= 0, "Choose a keyframe first")


def _film(
    id: str,
    keys: str,
    title: str,
    run: Callable[[AppState], object],
    menu: str,
    *words: str,
    lacks: Callable[[AppState], str] = _a_path,
    checked: Callable[[AppState], bool] = lambda app: False,
) -> Command:
    return Command(
        id=id,
        title=title,
        group="Film",
        run=run,
        keys=tuple(keys.split()),
        menu=menu,
        words=words,
        lacks=lacks,
        checked=checked,
    )


# fmt: off
FILM = (
    _film("add_keyframe", "Ctrl+K", "Keyframe: add one with this view to the film", film.add_keyframe,
        "Add keyframe", "key frame", "add key", "insert keyframe", lacks=_a_scene),
    _film("update_keyframe", "Ctrl+Shift+K", "Update the chosen keyframe: it gets this view",
        film.update_keyframe, "Update keyframe", "change keyframe", lacks=_a_choice),
    _film("delete_keyframe", "", "Delete the chosen keyframe of the film", film.delete_keyframe,
        "Delete keyframe", "remove keyframe", lacks=_a_choice),
    _film("next_keyframe", "Ctrl+Right", "Next keyframe of the film", partial(film.step_keyframe, by=1),
        "Next keyframe"),
    _film("previous_keyframe", "Ctrl+Left", "Previous keyframe of the film",
        partial(film.step_keyframe, by=-1), "Previous keyframe"),
    _film("play_film", "Shift+Space", "Play or pause the film", film.play_or_pause, "Play", "play film",
        "preview film", checked=lambda app: app.feature(Film).playing),
    _film("loop_film", "", "Loop: the film ends where it begins", film.toggle_loop, "Loop",
        checked=lambda app: (path := app.feature(Film).path) is not None and path.loop),
    _film("undo_film", "", "Undo the last change of the film's keyframes", film.undo, "Undo",
        lacks=needs(lambda app: app.feature(Film).can_undo, "Nothing to undo")),
    _film("turntable", "", "Turntable: a film once round what is seen, evenly", film.make_turntable,
        "Turntable", "orbit animation", "360", "spin", lacks=_a_scene),
    _film("open_camera_path", "", "Open a camera path of nerfstudio, SuperSplat or this program",
        film.choose_path_to_open, "Open camera path...", "load camera path", lacks=_a_scene),
    _film("save_camera_path", "", "Save the camera path, as nerfstudio and Blender read it",
        save.choose_path_to_save, "Save camera path..."),
    _film("export_film", "Ctrl+Shift+F12", "Export the film as a video, a GIF or PNG files",
        save.open_film_dialog, "Export film...", "video", "movie", "render film", "export video", "mp4",
        "gif"),
)
# fmt: on
