"""Harm done on purpose, to show that a soak sees it. Never drawn; only a log can ask for it."""

from __future__ import annotations

import threading
import time

import moderngl
import numpy as np
from actions_editing import Soaked


def picture(user: Soaked, rng: np.random.Generator) -> str:
    """The renderer forgets a part of the picture."""
    shown = user.app.picture
    assert shown is not None
    read = shown.read

    def wrong(*arguments: object, **options: object) -> np.ndarray:
        image = read(*arguments, **options).copy()  # pyright: ignore[reportArgumentType]
        image[: len(image) // 4] += 0.1
        return image

    shown.read = wrong  # pyright: ignore[reportAttributeAccessIssue]
    return ""


def thread(user: Soaked, rng: np.random.Generator) -> str:
    def die() -> None:
        raise RuntimeError("on purpose")

    threading.Thread(target=die, name="splatview-harm").start()
    time.sleep(0.1)
    return ""


def gl(user: Soaked, rng: np.random.Generator) -> str:
    def enable_nothing() -> None:
        moderngl.get_context().enable_direct(0xFFFF)

    user.on_gl_thread(enable_nothing)
    return ""


HARM = {"harm_picture": (0.0, picture), "harm_thread": (0.0, thread), "harm_gl": (0.0, gl)}
