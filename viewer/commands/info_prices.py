"""`splatview info --measure`: what each effect costs or saves here, by drawing with and without it."""

from __future__ import annotations

import argparse
import threading
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from ...measure.effect_prices import EffectPrice, price_effects
from ...measure.knobs import Plan
from ...scene import Camera, Gaussians, InputError
from ...scene.effects import Effect, settings_for
from .arguments import Parser, positive
from .cameras import add_camera_options, check_camera_options, chosen_orbit
from .ladder import FRAME_TURN, MEASURED, on_interrupt
from .plans import SceneArtist
from .renderers import make_headless

SECONDS = 15.0

CAMERA_OPTIONS = ("camera", "camera_index", "camera_name", "eye", "target", "up", "fov", "size")


def add_measure_options(parser: Parser) -> None:
    group = parser.add_argument_group("prices")
    group.add_argument(
        "--measure",
        action="store_true",
        help="also draw with each effect on and off, and tell the difference in time",
    )
    group.add_argument("--renderer", choices=("auto", *MEASURED), help="which one draws (default: auto)")
    group.add_argument("--seconds", type=positive, metavar="S", help=f"for how long (default: {SECONDS:g})")
    add_camera_options(parser)


def check_measure_options(args: argparse.Namespace) -> None:
    """Raises InputError where options of --measure are given without it."""
    if args.measure:
        check_camera_options(args)
        return
    for name in ("renderer", "seconds", *CAMERA_OPTIONS):
        if getattr(args, name, None) is not None:
            raise InputError(f"--{name.replace('_', '-')} goes with --measure")


def measured_prices(
    args: argparse.Namespace, gaussians: Gaussians, effects: list[Effect]
) -> tuple[dict[str, EffectPrice], dict[str, Any]]:
    """By name, the price of each effect that can be switched; and what they were measured by.

    Raises KeyboardInterrupt where the user ends it early: half of the prices are not said.
    """
    orbit = chosen_orbit(args, gaussians)
    artist = SceneArtist(make_headless(args.renderer or "auto"), gaussians, orbit.turned_from)
    camera = orbit.turned(0.0)
    stopped = threading.Event()

    def moved(_: int, number: int) -> Camera:
        return orbit.turned(FRAME_TURN * (number + 1))

    with Progress(
        BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}"), console=Console(stderr=True)
    ) as progress:
        task = progress.add_task("", total=1.0)
        with on_interrupt(stopped.set):
            prices = price_effects(
                artist,
                Plan(settings=settings_for(gaussians)),
                gaussians,
                effects,
                camera,
                moved=moved,
                seconds=args.seconds or SECONDS,
                on_progress=lambda share, text: progress.update(task, completed=share, description=text),
                cancelled=stopped.is_set,
            )
    if prices is None:
        raise KeyboardInterrupt
    return prices, {"renderer": artist.name, "size": [camera.width, camera.height]}


def price_as_json(price: EffectPrice) -> dict[str, Any]:
    """`saved_ms`: what a frame without the effect takes less than one with it."""
    return {
        "frame_ms": price.ms,
        "saved_ms": price.saved_ms,
        "noise_ms": price.noise_ms,
        "clear": price.clear,
        "max_change": price.max_error,
    }
