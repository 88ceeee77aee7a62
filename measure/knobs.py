"""Every shortcut that trades accuracy for time, declared once: the command line, the ladder, the panel and
the documentation all read this table.

A knob's values go from exact to coarse. A renderer that is not in its `renderers` does not have it, and
asking for it there is an error, never a silent difference.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from splatview.scene import InputError, RenderSettings
from splatview.scene.attribute_formats import FORMATS, Attributes
from splatview.scene.order_reuse import keeps_order

GL, TILES, CPU, REFERENCE = ("quads",), ("tiles",), ("cpu",), ("reference",)


@dataclass(frozen=True, kw_only=True)
class Plan:
    """All that decides a picture besides scene and camera: the settings, and what is done around them."""

    settings: RenderSettings = field(default_factory=RenderSettings)
    resolution: float = 1.0
    """Share of the sides that is drawn, and then enlarged to the full size."""
    kept: float = 1.0
    """Share of the splats that is drawn: those that make most of the scene's pictures."""
    attributes: Attributes = "float32"
    """How the renderer stores the scene, by `scene.stored`."""


@dataclass(frozen=True, kw_only=True)
class Value:
    """One position of a knob."""

    text: str
    """As it is typed after the option, and shown."""
    apply: Callable[[Plan], Plan]
    renderers: tuple[str, ...] | None = None
    """Which of the knob's have it; None: all."""
    expensive: bool = False
    """Takes many times as long as the exact value: it is there for something else."""


@dataclass(frozen=True, kw_only=True)
class Knob:
    """One shortcut."""

    name: str
    """Also its option: --name."""
    title: str
    changes: str
    """What it does to the picture, and what it saves, in a line."""
    renderers: tuple[str, ...]
    values: tuple[Value, ...]
    """From exact to coarse."""
    monotone: bool = True
    """Whether theory says that a coarser value cannot be nearer to the truth, but for luck."""

    @property
    def option(self) -> str:
        return f"--{self.name}"

    def values_for(self, renderer: str) -> tuple[Value, ...]:
        """Those that `renderer` has, from exact to coarse; none where it does not have the knob."""
        if renderer not in self.renderers:
            return ()
        return tuple(v for v in self.values if v.renderers is None or renderer in v.renderers)

    def value(self, text: str) -> Value:
        """The value typed as `text`. Raises InputError with those that there are."""
        for value in self.values:
            if value.text == text:
                return value
        raise InputError(f"{self.option} {text}: choose from {', '.join(v.text for v in self.values)}")


def _setting(
    text: str, renderers: tuple[str, ...] | None = None, *, expensive: bool = False, **changes: Any
) -> Value:
    return Value(
        text=text, apply=partial(_with_settings, changes=changes), renderers=renderers, expensive=expensive
    )


def _with_settings(plan: Plan, changes: Mapping[str, Any]) -> Plan:
    return replace(plan, settings=replace(plan.settings, **changes))


def _at_most_degree(plan: Plan, degree: int) -> Plan:
    now = plan.settings.sh_degree
    return _with_settings(plan, {"sh_degree": degree if now is None else min(now, degree)})


def _planned(text: str, **changes: Any) -> Value:
    return Value(text=text, apply=partial(_with_changes, changes=changes))


def _with_changes(plan: Plan, changes: Mapping[str, Any]) -> Plan:
    return replace(plan, **changes)


KNOBS: tuple[Knob, ...] = (
    Knob(
        name="sh-degree",
        title="SH degree",
        changes="highest band of view-dependent colour; lower saves reading and summing coefficients",
        renderers=GL + TILES + CPU + REFERENCE,
        values=tuple(
            Value(text=str(degree), apply=partial(_at_most_degree, degree=degree)) for degree in (3, 2, 1, 0)
        ),
    ),
    Knob(
        name="blend",
        title="Blend target",
        changes="precision in which splats are summed; coarser moves fewer bytes",
        renderers=GL,
        values=tuple(_setting(text, blend=text) for text in ("float32", "float16", "unorm8")),
    ),
    Knob(
        name="early-stop",
        title="Early stop",
        changes="a pixel ends when less light than this comes through; splats behind it cost nothing",
        renderers=GL + TILES + CPU,
        values=tuple(_setting(text, early_stop=float(text)) for text in ("0", "1e-4", "1e-2")),
    ),
    Knob(
        name="order",
        title="Depth order",
        changes="which splat is before which: by depths all told apart; by half the bits; along each pixel's"
        " own ray, another picture, without popping; or unsorted: a weighted sum, or one splat by chance, for"
        " quads, as sorting is but a tenth of a frame of the others",
        renderers=GL + TILES + CPU,
        values=(
            _setting("32-bit", order="32-bit"),
            _setting("16-bit", order="16-bit"),
            _setting("per-pixel", TILES + CPU, expensive=True, order="per-pixel"),
            _setting("weighted", GL, order="weighted"),
            _setting("stochastic", GL, order="stochastic"),
        ),
        monotone=False,
    ),
    Knob(
        name="cut",
        title="Footprint cut",
        changes="where a splat ends: at an alpha of 1/255 as in the image model, or nearer, at so many"
        " standard deviations; fewer pixels a splat",
        renderers=GL + TILES + CPU,
        values=(
            _setting("1/255", sigma_cut=None),
            _setting("3-sigma", sigma_cut=3.0),
            _setting("2-sigma", sigma_cut=2.0),
        ),
    ),
    Knob(
        name="resolution",
        title="Image scale",
        changes="draws fewer pixels and enlarges them; the coarsest shortcut of all",
        renderers=GL + TILES + CPU + REFERENCE,
        values=tuple(
            _planned(text, resolution=share) for text, share in (("1", 1.0), ("1/2", 0.5), ("1/4", 0.25))
        ),
    ),
    Knob(
        name="keep",
        title="Splats kept",
        changes="% of the splats, by what they contribute to views from all around; the rest is not drawn",
        renderers=GL + TILES + CPU + REFERENCE,
        values=tuple(_planned(text, kept=int(text) / 100) for text in ("100", "75", "50", "25")),
    ),
    Knob(
        name="attributes",
        title="Attribute precision",
        changes="bits in which the scene is stored: on the GPU fewer bytes are kept and read; cpu draws the"
        " same rounded values from float32 and saves nothing",
        renderers=GL + TILES + CPU,
        values=tuple(_planned(text, attributes=text) for text in FORMATS),
    ),
    Knob(
        name="resort",
        title="Order kept",
        changes="the order of splats is made anew in every so many frames of a moving camera, or when it has"
        " turned so far; in between it is an earlier view's; exact at rest. Measured at the end of a path, 1"
        " degree a frame",
        renderers=GL + TILES + CPU,
        values=(
            _setting("1", resort_frames=1, resort_degrees=0.0),
            _setting("4", resort_frames=4, resort_degrees=0.0),
            _setting("5deg", resort_frames=1, resort_degrees=5.0),
            _setting("16", resort_frames=16, resort_degrees=0.0),
        ),
    ),
)


def knob(name: str) -> Knob:
    """The knob called `name`. Raises InputError where there is none."""
    for candidate in KNOBS:
        if candidate.name == name:
            return candidate
    raise InputError(f"there is no knob {name!r}; there are {', '.join(k.name for k in KNOBS)}")


def has_all(choices: Mapping[str, str], renderer: str) -> bool:
    """Whether `renderer` has these values of knobs, by name."""
    return all(
        any(value.text == text for value in knob(name).values_for(renderer)) for name, text in choices.items()
    )


def apply_choices(plan: Plan, choices: Mapping[str, str], renderer: str) -> Plan:
    """`plan` with knobs set: name -> value as typed.

    Raises:
        InputError: a knob or value does not exist, or `renderer` does not have it.
    """
    for name, text in choices.items():
        chosen = knob(name)
        if renderer not in chosen.renderers:
            owners = " and ".join(chosen.renderers)
            raise InputError(f"{chosen.option} is not for --renderer {renderer}: {owners} can do it")
        value = chosen.value(text)
        if value.renderers is not None and renderer not in value.renderers:
            owners = " and ".join(value.renderers)
            raise InputError(f"{chosen.option} {text} is not for --renderer {renderer}: {owners} can do it")
        plan = value.apply(plan)
    return plan


# ---- Pictures that depend on those before: by which path a view is reached when they are measured.


PATH_TURN = 1.0
"""Degrees of a turn of the eye between two frames: at 60 frames a second, once round in six seconds."""


def path_to_view(settings: RenderSettings) -> tuple[float, ...]:
    """Degrees by which the frames of the path differ from the view, the view itself, 0, last.

    The first frame is sorted and none after it: so the view is drawn in the oldest order that the settings
    let happen on such a path. Only the view, where every frame has its own order.
    """
    if not keeps_order(settings):
        return (0.0,)
    frames = settings.resort_frames
    if settings.resort_degrees > 0:
        frames = max(math.ceil(settings.resort_degrees / PATH_TURN), 1)
    return tuple(-PATH_TURN * number for number in range(frames - 1, -1, -1))
