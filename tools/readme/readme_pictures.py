"""Makes the README's pictures with the program itself: `make pictures` (needs Xvfb for the window).

python tools/readme/readme_pictures.py [NAME ...]

Names: landscape, modes, window, timeline, editing, crop, film, accuracy, effects, training,
transients. None: all.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont, ImageGrab

FOLDER = Path(__file__).parents[2] / "assets" / "readme"
SPLATVIEW = Path(sys.executable).with_name("splatview")
WINDOW_SIZE = (1280, 800)
SECONDS_TO_SETTLE = 25
"""The demo is made, loaded, and its picture has come to rest; generous for a machine without a GPU."""
SECONDS_TO_CLOSE = 30
SECONDS_TO_EDIT = 180
SECONDS_TO_TRAIN = 75
"""The photos are made, and there is something to see on the curves."""


def render(*options: str | Path) -> None:
    """Runs the program where it finds no display."""
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    subprocess.run([SPLATVIEW, *map(str, options)], env=environment, check=True)


def landscape(folder: Path) -> None:
    render("-o", folder / "landscape.png")


def modes(folder: Path) -> None:
    """The demo's four visual modes in one picture, named."""
    from splatview.scene.demo import demo_camera, demo_scene
    from splatview.scene.formats import save_camera, save_scene

    tile = (640, 360)
    sheet = Image.new("RGB", (2 * tile[0], 2 * tile[1]))
    font = ImageFont.load_default(size=18)
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        save_scene(demo_scene(), work / "demo.ply")
        save_camera(demo_camera(*tile), work / "camera.json")
        for i, mode in enumerate(("points", "ellipsoids", "depth", "overdraw")):
            picture = work / f"{mode}.png"
            scene = ("render", work / "demo.ply", "--camera", work / "camera.json")
            render(*scene, "--renderer", "quads", "--mode", mode, "-o", picture)
            corner = (i % 2 * tile[0], i // 2 * tile[1])
            sheet.paste(Image.open(picture), corner)
            ImageDraw.Draw(sheet).text(
                (corner[0] + 12, corner[1] + 8), mode, "white", font, stroke_width=2, stroke_fill="black"
            )
    sheet.save(folder / "modes.png", optimize=True)


@contextmanager
def on_a_display() -> Iterator[dict[str, str]]:
    """A virtual display: the environment of programs that are to be seen on it."""
    ready, write_end = os.pipe()
    screen = "x".join(map(str, (*WINDOW_SIZE, 24)))
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write_end), "-screen", "0", screen], pass_fds=[write_end]
    )
    os.close(write_end)
    with os.fdopen(ready) as pipe:
        display = f":{pipe.readline().strip()}"
    try:
        with tempfile.TemporaryDirectory() as settings:
            (Path(settings) / "preferences.json").write_text('{"start_screen": false}', encoding="utf-8")
            yield os.environ | {"DISPLAY": display, "SPLATVIEW_CONFIG_DIR": settings}
    finally:
        server.terminate()
        server.wait()


def grab(
    command: Sequence[str | Path],
    path: Path,
    seconds: float,
    *,
    until: str | None = None,
    work: str | None = None,
) -> None:
    """Runs `command` on a display of its own, in the folder `work` or one of its own, and takes a picture of
    it after so many seconds, or as soon as it has made the file `until` in its settings."""
    with on_a_display() as environment, tempfile.TemporaryDirectory() as empty:
        viewer = subprocess.Popen(command, env=environment, cwd=work or empty)
        limit = time.monotonic() + seconds
        ready = Path(environment["SPLATVIEW_CONFIG_DIR"], until or "never")
        while time.monotonic() < limit and not ready.exists():
            time.sleep(0.2)
        ImageGrab.grab(xdisplay=environment["DISPLAY"]).save(path, optimize=True)
        viewer.terminate()
        try:
            viewer.wait(SECONDS_TO_CLOSE)
        except subprocess.TimeoutExpired:
            viewer.kill()
            viewer.wait()


def window(folder: Path) -> None:
    """The window on the demo."""
    grab([SPLATVIEW], folder / "window.png", SECONDS_TO_SETTLE)


def timeline(folder: Path) -> None:
    """The window on a sequence, frames of the demo in a wind, one of them damaged."""
    from dataclasses import replace

    import numpy as np

    from splatview.scene.demo import demo_scene
    from splatview.scene.formats import save_scene

    scene = demo_scene()
    with tempfile.TemporaryDirectory() as name:
        frames = Path(name) / "wind"
        frames.mkdir()
        for i in range(24):
            means = scene.means.copy()
            means[:, 0] += (0.1 * np.sin(0.26 * i + means[:, 2])).astype(means.dtype)
            save_scene(replace(scene, means=means), frames / f"frame_{i + 1}.splat")
        (frames / "frame_9.splat").write_bytes(b"damaged")
        grab([SPLATVIEW, "wind"], folder / "timeline.png", SECONDS_TO_SETTLE, work=name)


def editing(folder: Path) -> None:
    """The window on the demo while it is cleaned up."""
    drive = Path(__file__).with_name("readme_windows.py")
    grab([sys.executable, drive, "editing"], folder / "editing.png", SECONDS_TO_EDIT, until="readme-ready")


def crop(folder: Path) -> None:
    """The window on the demo with a crop box, one face of which has been dragged."""
    drive = Path(__file__).with_name("readme_windows.py")
    grab([sys.executable, drive, "crop"], folder / "crop.png", SECONDS_TO_EDIT, until="readme-ready")


def film(folder: Path) -> None:
    """The window on the demo with keyframes of a film, and their way over the picture."""
    drive = Path(__file__).with_name("readme_windows.py")
    grab([sys.executable, drive, "film"], folder / "film.png", SECONDS_TO_EDIT, until="readme-ready")


def accuracy(folder: Path) -> None:
    """The window on the demo with prices of shortcuts, and exact beside one."""
    drive = Path(__file__).with_name("readme_windows.py")
    grab([sys.executable, drive, "accuracy"], folder / "accuracy.png", SECONDS_TO_EDIT, until="readme-ready")


def effects(folder: Path) -> None:
    """The window on the demo with the receipt of its effects, and the evidence of one."""
    drive = Path(__file__).with_name("readme_windows.py")
    grab([sys.executable, drive, "effects"], folder / "effects.png", SECONDS_TO_EDIT, until="readme-ready")


def training(folder: Path) -> None:
    """The window while the demo's photos are trained on."""
    command = [SPLATVIEW, "train", "--demo", "-o", "demo.ply", "--minutes", "3"]
    grab(command, folder / "training.png", SECONDS_TO_TRAIN)


def transients(folder: Path) -> None:
    """A photo of the demo with what passes before it, dark where training masks it; and the scene that is
    trained from such photos as they are, and with masks."""
    from dataclasses import replace

    import numpy as np

    from splatview.raster import render as draw
    from splatview.scene.captures.demo import demo_capture
    from splatview.trainer.setup import settings_for, trainer_for
    from splatview.trainer.views import TrainViews, train_views

    capture = demo_capture(draw, photos=16, width=320, height=180)
    views = train_views(capture.train)
    y, x = np.mgrid[:180, :320]
    for place in range(1, len(views), 4):
        pixels = views[place].pixels.copy()
        middle, colour = 60 + 37 * place % 200, ((200, 60, 50), (60, 90, 200), (230, 200, 60))[place % 3]
        body = ((x - middle) / 22) ** 2 + ((y - 125) / 60) ** 2 < 1
        head = (x - middle) ** 2 + (y - 50) ** 2 < 14**2
        pixels[body], pixels[head] = colour, (205, 165, 140)
        views[place] = replace(views[place], pixels=pixels)
    tiles = []
    for mode in ("off", "auto"):
        trained = TrainViews(views, 0)
        settings = settings_for(capture, trained, iterations=1500, transients=mode, max_splats=20_000)
        trainer = trainer_for(capture, trained, settings, centre=np.zeros(3))
        while not trainer.done:
            trainer.step()
        name = next(iter(trainer.views.in_part), views[0].camera.name)
        cameras = [photo.camera for photo in capture.held_out]
        tiles.append([draw(trainer.snapshot(), camera)[..., :3] for camera in cameras])
    part = trainer.views.in_part[name]
    dark = (
        part.pixels / 255 if part.mask is None else part.pixels / 255 * np.where(part.mask, 1, 0.3)[..., None]
    )
    shown = max(zip(*tiles, strict=True), key=lambda pair: np.abs(pair[0] - pair[1]).mean())
    sheet = np.concatenate([dark, *shown], axis=1)
    Image.fromarray((np.clip(sheet, 0, 1) * 255 + 0.5).astype(np.uint8)).save(
        folder / "transients.png", optimize=True
    )


MAKERS = {
    "landscape": landscape,
    "modes": modes,
    "window": window,
    "timeline": timeline,
    "editing": editing,
    "crop": crop,
    "film": film,
    "accuracy": accuracy,
    "effects": effects,
    "training": training,
    "transients": transients,
}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pictures", nargs="*", help=f"of {', '.join(MAKERS)}; all if none is named")
    chosen = parser.parse_args().pictures or list(MAKERS)
    if unknown := set(chosen) - set(MAKERS):
        parser.error(f"no such picture: {', '.join(sorted(unknown))}")
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in chosen:
        MAKERS[name](FOLDER)
        print(f"{FOLDER / name}.png")
