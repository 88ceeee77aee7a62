"""Makes the README's pictures with the program itself: `make pictures` (needs Xvfb for the window).

python scripts/readme_pictures.py [NAME ...]      names: landscape, modes, window
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont, ImageGrab

FOLDER = Path(__file__).parents[1] / "assets" / "readme"
SPLATVIEW = Path(sys.executable).with_name("splatview")
WINDOW_SIZE = (1280, 800)
SECONDS_TO_SETTLE = 25
"""The demo is made, loaded, and its picture has come to rest; generous for a machine without a GPU."""


def render(*options: str | Path) -> None:
    """Runs the program where it finds no display."""
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    subprocess.run([SPLATVIEW, *map(str, options)], env=environment, check=True)


def landscape(folder: Path) -> None:
    render("-o", folder / "landscape.png")


def modes(folder: Path) -> None:
    """The demo's four visual modes in one picture, named."""
    from splatview.scene.demo import demo_camera, demo_scene
    from splatview.scene.files import save_camera, save_scene

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


def window(folder: Path) -> None:
    """The window on the demo, under a virtual display."""
    ready, write_end = os.pipe()
    screen = "x".join(map(str, (*WINDOW_SIZE, 24)))
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write_end), "-screen", "0", screen], pass_fds=[write_end]
    )
    os.close(write_end)
    with os.fdopen(ready) as pipe:
        display = f":{pipe.readline().strip()}"
    with tempfile.TemporaryDirectory() as settings:
        environment = os.environ | {"DISPLAY": display, "SPLATVIEW_CONFIG_DIR": settings}
        viewer = subprocess.Popen([SPLATVIEW], env=environment)
        time.sleep(SECONDS_TO_SETTLE)
        ImageGrab.grab(xdisplay=display).save(folder / "window.png", optimize=True)
        viewer.terminate()
        viewer.wait()
    server.terminate()
    server.wait()


if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    makers = {"landscape": landscape, "modes": modes, "window": window}
    for chosen in sys.argv[1:] or makers:
        makers[chosen](FOLDER)
        print(f"{FOLDER / chosen}.png")
