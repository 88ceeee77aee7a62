"""The recipe of a training, below its controls: what may be changed on the way, and what was decided."""

from __future__ import annotations

from imgui_bundle import ImVec4, imgui

from ....trainer.settings import TrainSettings
from .. import theme
from ..core import Core
from ..panels import widgets
from . import actions

DEFAULTS = TrainSettings()

STRATEGIES = {"mcmc": "MCMC", "classic": "Classic"}


def show(core: Core) -> None:
    if core.training is None:
        return
    status = core.training.status
    settings = status.settings
    length(core, settings)
    factor = widgets.slider(
        "Position rate",
        settings.means_rate / DEFAULTS.means_rate,
        0.1,
        10.0,
        "How far splats move in a step, times what is usual. More finds far places sooner, less is calmer.",
        form="%.2f x",
        logarithmic=True,
    )
    if factor is not None:
        set_position_rate(core, factor)
    most = widget_count(
        "Most splats",
        settings.max_splats,
        "Density control adds none beyond this. Fewer are faster, and learn fewer photos by heart.",
        step=1000,
    )
    if most is not None:
        core.post(lambda core: actions.change_settings(core, max_splats=max(most, 1)))
    choices = [str(degree) for degree in range(status.sh_degree, 4)]
    degree = widgets.combo(
        "SH degree",
        str(max(settings.sh_degree, status.sh_degree)),
        choices,
        f"Bands of view-dependent colour in the end; {status.sh_degree} by now. Bands in training stay.",
    )
    if degree is not None:
        core.post(lambda core: actions.change_settings(core, sh_degree=int(degree)))
    imgui.spacing()
    widgets.fact("Strategy", STRATEGIES[settings.strategy], "How splats are born and die.")
    widgets.fact("Seed", str(settings.seed), "Of all that is random.")
    first = core.training.photos[0].camera
    held_out = sum(photo.held_out for photo in core.training.photos)
    widgets.fact("Photos", f"{len(core.training.photos) - held_out} + {held_out} held out")
    widgets.fact("First photo", f"{first.width} x {first.height} px", "After downscaling.")
    red, green, blue = settings.background
    widgets.fact("Background", f"{red:.2f}, {green:.2f}, {blue:.2f}", "Behind the scene, RGB.")
    widgets.fact("Loss", f"{1 - settings.ssim_weight:g} L1 + {settings.ssim_weight:g} (1 - SSIM)")
    widgets.section("Effects")
    effects(core)


def effects(core: Core) -> None:
    """What the run computes, decided from the capture; the evidence on demand."""
    if core.training is None:
        return
    for effect in core.training.thread.effects:
        on = effect.in_force
        if effect.name == "SH bands":
            on = core.training.status.sh_degree > 0
        imgui.text_colored(ImVec4(*theme.ACCENT, 1) if on else theme.QUIET, "on" if on else "off")
        imgui.same_line(imgui.get_font_size() * 2.6)
        imgui.text(effect.name)
        widgets.tooltip(effect.why)


def length(core: Core, settings: TrainSettings) -> None:
    """The end of the run: moving it changes how fast rates decay from here on."""
    if settings.iterations is not None:
        steps = widget_count(
            "Length, steps",
            settings.iterations,
            "When the run is over. All schedules follow: a longer run decays later. Above the steps done, a "
            "run that is over can be resumed.",
            step=1000,
        )
        if steps is not None:
            core.post(lambda core: actions.change_settings(core, iterations=max(steps, 1)))
    if settings.minutes is not None:
        tip = "When the run is over, pauses not counted. All schedules follow."
        widgets.label("Length, minutes", tip)
        changed, minutes = imgui.input_float("##Length, minutes", settings.minutes, 1.0, 10.0, "%.1f")
        widgets.tooltip(tip)
        if changed and minutes > 0:
            core.post(lambda core: actions.change_settings(core, minutes=minutes))


def widget_count(name: str, value: int, tip: str, *, step: int) -> int | None:
    """A row with a whole number to type or step; the new one where the user changed it."""
    widgets.label(name, tip)
    changed, value = imgui.input_int(
        f"##{name}", value, step, 10 * step, imgui.InputTextFlags_.enter_returns_true
    )
    widgets.tooltip(tip)
    return value if changed else None


def set_position_rate(core: Core, factor: float) -> None:
    """Both ends of the curve of the positions' rate, times what is usual."""
    core.post(
        lambda core: actions.change_settings(
            core,
            means_rate=factor * DEFAULTS.means_rate,
            means_rate_end=factor * DEFAULTS.means_rate_end,
        )
    )
