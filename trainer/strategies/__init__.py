"""Strategies of density control: the table of their settings and classes. Each is a module of its own."""

from __future__ import annotations

from dataclasses import dataclass

from splatview.trainer.strategies.default import DefaultSettings, DefaultStrategy
from splatview.trainer.strategies.mcmc import MCMCSettings, MCMCStrategy
from splatview.trainer.strategies.ops import DensitySettings, Strategy

STRATEGIES: dict[str, tuple[type[DensitySettings], type[Strategy]]] = {
    "mcmc": (MCMCSettings, MCMCStrategy),
    "classic": (DefaultSettings, DefaultStrategy),
}
"""By the name that command lines and checkpoints have: the settings' class and the strategy's, the default
first."""


@dataclass(frozen=True, kw_only=True)
class StrategySettings(MCMCSettings, DefaultSettings):
    """Settings of all strategies, side by side: a recipe may change its strategy, and files are flat."""
