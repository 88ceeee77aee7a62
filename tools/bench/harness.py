"""What benchmarks share: ways measured in turn, medians with their spread, views, options, a window's screen.

Figures go to JSON by `splatview.measure.machine.write_results`, which adds the machine; `benchmark_docs`
makes the tables of the pages from it.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import moderngl
import numpy as np

from splatview.measure.machine import FOLDER
from splatview.renderers.gl.context import describe
from splatview.scene import Camera, Gaussians
from splatview.scene.formats import load_scene
from splatview.scene.framing import frame_camera, robust_bounds

sys.path.append(str(Path(__file__).parents[1] / "soak"))
from screen import screen

TURN = 3.0
"""Degrees that the eye moves about the scene's centre before each frame."""

PANELS = (390, 54)
"""Px of the window beside and above the picture, about; what is measured is reported."""


@dataclass
class Timings:
    """The rounds of one way."""

    ms: list[float] = field(default_factory=list)
    """Elapsed milliseconds."""
    cpu_ms: list[float] = field(default_factory=list)
    """Processor milliseconds of all threads: on two cores twice the elapsed ones, unless others used them."""
    values: list[Any] = field(default_factory=list)
    """What the way returned."""

    @property
    def median(self) -> float:
        """Elapsed milliseconds."""
        return float(np.median(self.ms))

    @property
    def range(self) -> list[float]:
        """Least and most elapsed milliseconds."""
        return [min(self.ms), max(self.ms)]

    def medians(self) -> dict[str, float]:
        """Of values that are milliseconds by stage, stage by stage."""
        return {stage: float(np.median([value[stage] for value in self.values])) for stage in self.values[0]}


def in_turn(
    ways: Mapping[str, Callable[[int], Any]],
    rounds: int,
    *,
    warm_up: int = 1,
    rotate: bool = True,
    after_round: Callable[[int], object] = lambda number: None,
) -> dict[str, Timings]:
    """Every way once a round, so that a machine that drifts decides nothing.

    A way gets the round's number. `warm_up` rounds come before the `rounds` that count: programs compile and
    memory is touched. `rotate`: each round begins with another way. `after_round` is not timed.
    """
    timings = {name: Timings() for name in ways}
    names = list(ways)
    for number in range(warm_up + rounds):
        first = number % len(names) if rotate else 0
        for name in names[first:] + names[:first]:
            begun, cpu_begun = time.perf_counter(), time.process_time()
            value = ways[name](number)
            elapsed, busy = time.perf_counter() - begun, time.process_time() - cpu_begun
            if number >= warm_up:
                timings[name].ms.append(1000 * elapsed)
                timings[name].cpu_ms.append(1000 * busy)
                timings[name].values.append(value)
        after_round(number)
    return timings


def spread(median: float, low_high: Sequence[float], digits: int = 0) -> str:
    """A table's cell: the median, and in brackets the least and the most."""
    low, high = low_high
    return f"{median:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def peak_bytes(work: Callable[[], object]) -> int:
    """The most memory that `work` held besides what was there before."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def turned(camera: Camera, centre: np.ndarray, degrees: float) -> Camera:
    """The camera carried about the vertical axis through `centre`."""
    angle = math.radians(degrees)
    carry = np.eye(4)
    carry[[0, 0, 2, 2], [0, 2, 0, 2]] = math.cos(angle), math.sin(angle), -math.sin(angle), math.cos(angle)
    carry[:3, 3] = centre - carry[:3, :3] @ centre
    return replace(camera, world_to_camera=camera.world_to_camera @ carry)


def orbit_of(gaussians: Gaussians, size: tuple[int, int]) -> Callable[[int], Camera]:
    """View `i` of a turn about the whole scene."""
    camera, (centre, _) = frame_camera(gaussians, *size), robust_bounds(gaussians.means)
    return lambda i: turned(camera, centre, TURN * i)


def size_of(text: str) -> tuple[int, int]:
    """ "WxH" -> px.

    Raises:
        ValueError: it is something else; argparse says so.
    """
    width, height = (int(part) for part in text.split("x"))
    return width, height


def make_parser(
    doc: str | None,
    output: str,
    *,
    scene: bool = False,
    scenes: bool = False,
    size: str | None = None,
    frames: int | None = None,
) -> argparse.ArgumentParser:
    """Options that most benchmarks have: results go to `output` of `FOLDER`."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    if scene:
        parser.add_argument("scene", nargs="?", type=Path)
    if scenes:
        parser.add_argument("scenes", nargs="*", type=Path)
    if size:
        parser.add_argument("--size", default=size_of(size), type=size_of, metavar="WxH")
    if frames:
        parser.add_argument("--frames", type=int, default=frames)
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / output)
    return parser


def load_scenes(paths: Sequence[Path], otherwise: Callable[[], dict[str, Gaussians]]) -> dict[str, Gaussians]:
    """The scenes by their files' names, those of `otherwise` where no file is given."""
    return {path.name: load_scene(path) for path in paths} if paths else otherwise()


def window_environment(display: str, folder: str) -> dict[str, str]:
    """That of a window on `display` with its settings in `folder`. Mesa is told to leave the GPU alone,
    unless who runs the benchmark has said something on that: LIBGL_ALWAYS_SOFTWARE=0 is for a GPU."""
    environment = {"LIBGL_ALWAYS_SOFTWARE": "1"} | os.environ
    environment |= {"DISPLAY": display, "SPLATVIEW_CONFIG_DIR": folder}
    environment.pop("WAYLAND_DISPLAY", None)
    return environment


def gl_in_words() -> str:
    """What draws the window whose OpenGL context is this thread's, as a table says it."""
    info = describe(moderngl.create_context())
    return "without a GPU" if info.is_software else f"on {info.renderer}"


def in_window(script: str, arguments: Sequence[object], size: tuple[int, int], *, timeout: float) -> Any:
    """The JSON that `script` writes to the file named last on its command line, run with a screen of its own
    on which a window with a picture of `size` fits."""
    with (
        screen(f"{size[0] + PANELS[0]}x{size[1] + PANELS[1]}") as made,
        tempfile.TemporaryDirectory() as folder,
    ):
        report = Path(folder) / "report.json"
        environment = window_environment(made.display, folder)
        command = [sys.executable, script, *map(str, arguments), str(report)]
        subprocess.run(command, env=environment, check=True, timeout=timeout)
        return json.loads(report.read_text())
