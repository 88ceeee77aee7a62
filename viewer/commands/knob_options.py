"""The knobs of the accuracy ladder as command-line options."""

from __future__ import annotations

import argparse

from ...measure.knobs import KNOBS, Plan, apply_choices
from ...scene import RenderSettings
from .arguments import Parser


def add_knob_options(parser: Parser) -> None:
    group = parser.add_argument_group(
        "shortcuts (exact values first; `splatview ladder` measures what each costs and saves)"
    )
    for knob in KNOBS:
        values = ", ".join(value.text for value in knob.values)
        owners = ", ".join(name for name in knob.renderers if name != "reference")
        group.add_argument(
            knob.option,
            metavar=knob.name.rpartition("-")[2].upper(),
            help=f"{values} ({owners}): {knob.changes}".replace("%", "%%"),
        )


def knob_choices(args: argparse.Namespace) -> dict[str, str]:
    """Knob -> value as typed, of those that were given."""
    given = {knob.name: getattr(args, knob.name.replace("-", "_")) for knob in KNOBS}
    return {name: text for name, text in given.items() if text is not None}


def check_knob_options(args: argparse.Namespace) -> None:
    """Raises InputError for what cannot work, as far as that is known before the renderer is."""
    for name, text in knob_choices(args).items():
        if args.renderer == "auto":
            next(knob for knob in KNOBS if knob.name == name).value(text)
        else:
            apply_choices(Plan(), {name: text}, args.renderer)


def chosen_plan(args: argparse.Namespace, settings: RenderSettings, renderer: str) -> Plan:
    """The options' plan for the renderer called `renderer`, as "auto" chose it.

    Raises:
        InputError: it does not have a knob that was asked for.
    """
    return apply_choices(Plan(settings=settings), knob_choices(args), renderer)
