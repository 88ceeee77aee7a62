"""Outdoor scenes for the bench: splats under a sky that is painted at infinity, by direction alone.

Nothing of a sky comes from a splat, so that its truth is known in every direction: `Outdoors.picture` draws
what a camera sees, and which of its pixels are sky. Some cameras are `probes`: they look where no photo does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatview.raster import render
from splatview.scene import Camera, Gaussians
from splatview.scene.camera import look_at
from splatview.scene.captures.demo import demo_truth
from splatview.scene.demo.primitives import fbm, mix, smoothstep, unit
from splatview.scene.formats import load_scene
from splatview.scene.framing import bulk

UP = np.array([0.0, -1.0, 0.0])

SKY = 0.5
"""Opacity of all splats together below which a pixel above the horizon is sky."""

DOME = 40.0
"""The demo's own sky is splats beyond this distance, world units."""

Backdrop = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Colours (N, 3) and whether they are sky (N,), from eye (3,) along unit directions (N, 3)."""


@dataclass(frozen=True, eq=False)
class Outdoors:
    """Splats, what is behind them, and who looks at them."""

    scene: Gaussians
    backdrop: Backdrop
    cameras: list[Camera]
    probes: list[Camera]
    points: np.ndarray
    """(P, 3) float64: places on what the backdrop has nearby."""

    def picture(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """(H, W, 3) float64 within 0..1 and (H, W) bool: which pixels are sky."""
        drawn = np.clip(np.nan_to_num(render(self.scene, camera)), 0, 1).astype(np.float64)
        x, y = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
        rays = camera.points_at(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2), 1.0)
        colours, sky = self.backdrop(camera.eye, unit(rays @ camera.R_camera_world))
        shape = (camera.height, camera.width)
        through = 1 - drawn[..., 3:]
        return drawn[..., :3] + through * colours.reshape(*shape, 3), sky.reshape(shape) & (
            drawn[..., 3] < SKY
        )


def fair(directions: np.ndarray) -> np.ndarray:
    """A blue day with clouds and a sun: colours (N, 3) of unit directions (N, 3)."""
    height = np.clip(directions @ UP, -0.2, 1)
    colour = mix(np.array([0.80, 0.87, 0.95]), np.array([0.22, 0.42, 0.82]), np.clip(height, 0, 1) ** 0.6)
    density = fbm(directions * (3.0, 7.0, 3.0) + 5.1, 77, octaves=4)
    cover = smoothstep(0.0, 0.45, density) * smoothstep(-0.05, 0.15, height)
    colour = mix(colour, np.array([0.95, 0.95, 0.94]), 0.85 * cover)
    towards = directions @ unit(np.array([-0.5, -0.6, 0.62]))
    glow = 0.5 * np.exp((towards - 1) * 40) + (towards > np.cos(np.radians(1.5)))
    return np.clip(colour + glow[:, None] * (0.5, 0.45, 0.3), 0, 1)


def dusk(directions: np.ndarray) -> np.ndarray:
    """An evening: orange at one side of the horizon, violet above, streaks of cloud, far hills before it."""
    height = directions @ UP
    azimuth = np.arctan2(directions[:, 0], directions[:, 2])
    west = 0.5 + 0.5 * np.cos(azimuth - 0.7)
    low = mix(np.array([0.55, 0.48, 0.62]), np.array([0.98, 0.62, 0.30]), west)
    colour = mix(low, np.array([0.16, 0.17, 0.38]), np.clip(height, 0, 1) ** 0.5)
    streaks = fbm(directions * (2.0, 16.0, 2.0) + 1.7, 31, octaves=3)
    colour = mix(colour, np.array([0.92, 0.60, 0.52]), 0.6 * smoothstep(0.05, 0.4, streaks) * (height < 0.8))
    ridge = np.radians(5 + 2.5 * np.sin(3 * azimuth + 0.4) + 1.2 * np.sin(11 * azimuth) + np.sin(5 * azimuth))
    hills = np.arcsin(np.clip(height, -1, 1)) < ridge
    rocks = 0.06 * fbm(directions * 25.0, 5, octaves=3)
    return np.where(hills[:, None], (0.24, 0.25, 0.33) + rocks[:, None], np.clip(colour, 0, 1))


def overcast(directions: np.ndarray) -> np.ndarray:
    """Clouds without a gap: three times as bright above as at the horizon (Moon and Spencer 1942)."""
    light = (1 + 2 * np.clip(directions @ UP, 0, 1)) / 3 + 0.03 * fbm(directions * 4.0, 3, octaves=3)
    return np.clip(light, 0, 1)[:, None] ** 0.45 * np.array([0.93, 0.95, 0.98])


def meadow(sky: Callable[[np.ndarray], np.ndarray], level: float, size: float) -> Backdrop:
    """A sky over a plane at y = `level` with patches as large as `size`, world units."""

    def at(eye: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        down = -(directions @ UP)
        with np.errstate(divide="ignore"):
            way = np.where(down > 1e-6, (level - eye[1]) / np.maximum(down, 1e-6), np.inf)
        places = eye + directions * np.where(way < np.inf, way, 0)[:, None]
        patches = fbm(places / size + 9.3, 12, octaves=4)
        ground = mix(np.array([0.34, 0.30, 0.16]), np.array([0.30, 0.46, 0.20]), 0.5 + 0.8 * patches)
        # Mist on the far plane: no detail finer than a pixel.
        haze = 1 - np.exp(-way / (25 * size))
        ground = mix(np.clip(ground, 0, 1), np.array([0.30, 0.31, 0.34]), haze)
        above = down <= 1e-6
        return np.where(above[:, None], sky(directions), ground), above

    return at


def demo_outdoors(data: Path, count: int) -> Outdoors:
    """The demo's landscape without its own sky: cameras about the pond look outwards and upwards."""
    whole = demo_truth(60_000)
    scene = whole.take(np.flatnonzero(np.linalg.norm(whole.means, axis=1) < DOME))
    middle, cameras = np.array([0.3, -1.0, 0.2]), []
    for i in range(count):
        angle = np.radians(200 * ((i * 0.6180339887498949) % 1.0) - 100)
        rise = np.radians(-4 + 34 * ((i * 0.7548776662466927) % 1.0))
        eye = middle + 2.2 * np.array(
            [np.sin(3 * angle + i), -0.25 * ((i * 0.5698402909980532) % 1.0), np.cos(5 * angle + i)]
        )
        cameras.append(towards(eye, angle, rise, 256, 192))
    return Outdoors(
        scene=scene,
        backdrop=lambda eye, directions: (fair(directions), directions @ UP > -0.05),
        cameras=cameras,
        probes=probes_at(middle, 256, 192),
        points=np.empty((0, 3)),
    )


BIKER, GUITAR = "biker/biker.compressed.ply", "guitar/guitar.compressed.ply"


def biker_outdoors(data: Path, count: int) -> Outdoors:
    """A rider in the evening."""
    return outdoors(load_scene(data / "scenes" / BIKER), dusk, count)


def guitar_outdoors(data: Path, count: int) -> Outdoors:
    """A guitar under an overcast sky."""
    return outdoors(load_scene(data / "scenes" / GUITAR), overcast, count)


def outdoors(scene: Gaussians, sky: Callable[[np.ndarray], np.ndarray], count: int) -> Outdoors:
    """A thing on a plain, seen from all around at the height of a walker's eye."""
    centre, radius = bulk(scene)
    level = float(np.percentile(scene.means[:, 1], 99.5))
    cameras = []
    for i in range(count):
        angle = np.radians(360 * ((i * 0.6180339887498949) % 1.0))
        height = np.radians(1 + 16 * ((i * 0.7548776662466927) % 1.0))
        away = np.array([np.sin(angle) * np.cos(height), -np.sin(height), -np.cos(angle) * np.cos(height)])
        eye = centre + (2.0 + 0.8 * ((i * 0.5698402909980532) % 1.0)) * radius * away
        eye[1] = min(eye[1], level - 0.15 * radius)
        cameras.append(look_at(eye, centre + 0.3 * radius * UP, up=UP, fov_y=55, width=240, height=240))
    rng = np.random.default_rng(2)
    places = centre + radius * 4 * rng.uniform(-1, 1, (3000, 3)) * (1, 0, 1)
    places[:, 1] = level + rng.normal(scale=0.004 * radius, size=len(places))
    return Outdoors(
        scene=scene,
        backdrop=meadow(sky, level, radius),
        cameras=cameras,
        probes=probes_at(centre + 1.5 * radius * UP, 240, 240),
        points=places,
    )


ROOM = np.array([3.2, 1.6, 2.7])
"""Half sides of the room, in radii of who stands in it."""


def room(centre: np.ndarray, half: np.ndarray) -> Backdrop:
    """A box with a plain, unevenly lit ceiling, plain walls with pictures on two of them, and a carpet."""

    def at(eye: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with np.errstate(divide="ignore"):
            ways = (centre + np.sign(directions) * half - eye) / directions
        axis = np.argmin(ways, axis=1)
        rows = np.arange(len(directions))
        places = (eye + directions * ways[rows, axis][:, None] - centre) / half
        light = (0.92 - 0.22 * np.linalg.norm(places - (0.3, -1, 0.2), axis=1) / 2)[:, None]
        colour = light * np.array([0.90, 0.88, 0.84])
        pictures = (axis == 2) & (np.abs(places[:, 0]) < 0.4) & (np.abs(places[:, 1] + 0.1) < 0.4)
        carpet = (axis == 1) & (directions[:, 1] > 0)
        pattern = 0.5 + fbm(places * half / half.min() * 9 + 2.2, 8, octaves=4)
        for where, tint in ((pictures, (0.5, 0.4, 0.8)), (carpet, (0.5, 0.3, 0.25))):
            colour[where] = np.clip(pattern[where, None] * tint, 0, 1)
        return np.clip(colour, 0, 1), np.zeros(len(directions), bool)

    return at


def biker_indoors(data: Path, count: int) -> Outdoors:
    """The rider in a room, a half of the photos outwards."""
    return indoors(load_scene(data / "scenes" / BIKER), count, outwards=2)


def guitar_indoors(data: Path, count: int) -> Outdoors:
    """The guitar in a room, all photos inwards."""
    return indoors(load_scene(data / "scenes" / GUITAR), count, outwards=count + 1)


def indoors(scene: Gaussians, count: int, *, outwards: int) -> Outdoors:
    """A thing in a room with plain walls and ceiling: photos from around, one of so many outwards. Points are
    where a reconstruction finds some: on the carpet, the pictures and along the edges."""
    centre, radius = bulk(scene)
    half, cameras = ROOM * radius, []
    for i in range(count):
        angle = np.radians(360 * ((i * 0.6180339887498949) % 1.0))
        rise = np.radians(-15 + 35 * ((i * 0.7548776662466927) % 1.0))
        eye = centre + 2.0 * radius * np.array([np.sin(angle), -0.3 * ((i * 0.57) % 1.0), -np.cos(angle)])
        cameras.append(towards(eye, -angle + (np.pi if i % outwards == 1 else 0.0), rise, 240, 240))
    rng = np.random.default_rng(4)
    carpet = rng.uniform(-1, 1, (1500, 3)) * (1, 0, 1) + (0, 1, 0)
    pictures = rng.uniform(-0.4, 0.4, (600, 3)) * (1, 1, 0) + (0, -0.1, 1)
    pictures[::2, 2] = -1
    edges = rng.uniform(-1, 1, (600, 3))
    two = rng.integers(0, 3, len(edges))
    for k in range(3):
        edges[two != k, k] = np.sign(edges[two != k, k])
    return Outdoors(
        scene=scene,
        backdrop=room(centre, half),
        cameras=cameras,
        probes=[],
        points=centre + half * np.concatenate([carpet, pictures, edges]),
    )


def towards(eye: np.ndarray, azimuth: float, rise: float, width: int, height: int) -> Camera:
    """A camera at `eye` that looks along an azimuth, up by `rise`; both in radians."""
    ahead = np.array(
        [np.sin(azimuth) * np.cos(rise), -np.sin(rise), np.cos(azimuth) * np.cos(rise)], np.float64
    )
    return look_at(eye, eye + ahead, up=UP, fov_y=60, width=width, height=height)


def probes_at(eye: np.ndarray, width: int, height: int) -> list[Camera]:
    """Cameras in one place that look all around, at 20 and at 65 degrees above the horizon."""
    turns = np.radians(np.arange(0, 360, 45))
    return [towards(eye, turn, np.radians(rise), width, height) for rise in (20, 65) for turn in turns]
