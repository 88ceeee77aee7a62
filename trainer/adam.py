"""Adam as an optimiser of torch whose step is one kernel over the splats that a picture has seen."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch.optim import Optimizer

from splatview.raster import Parameters, available_threads
from splatview.raster.compiling import SPLATS_PER_TASK, TASKS_PER_THREAD, even_ranges, run
from splatview.trainer.adam_kernels import BETA1, BETA2, EPSILON, FEWEST_FOR_FAST, REST_DIVISOR, Rates, move
from splatview.trainer.splats import Splats

FAST_SCALES = {"log_scales_rate": 8e-2, "log_scales_rate_end": 5e-4}
"""Of the strategy mcmc, see "How fast scales change" in docs/training-recipe.md; the classic has the
paper's."""


def automatic_scale_rates(photos: int, everywhere: bool, strategy: str) -> dict[str, float]:
    """`FAST_SCALES`, where they suit so many photos; `everywhere`: as in `automatic_steps`. Few photos
    are learnt by heart the faster: 13 of `banana`, every 8th held out, 375x249 px, a minute, two seeds, have
    27.87 dB by these and 28.40 by the paper's rate."""
    return {} if strategy != "mcmc" or (everywhere and photos < FEWEST_FOR_FAST) else dict(FAST_SCALES)


def _plain(method: Callable[..., Any]) -> Callable[..., Any]:
    """torch's method without the decorator that imports torch's compiler when it is first called, which none
    of this needs: 1.8 s of processor time at the start of each run."""
    return getattr(method, "__wrapped__", method)


class SelectiveAdam(Optimizer):
    """Adam that moves only visible splats, all attributes in one pass; see `adam_kernels`.

    There is one group for each attribute, with its "name" and "lr"; schedulers of torch work on them. Other
    options of groups, like Adam's weight decay in torch, are gradients of losses that never become a graph:
    "reg" of "opacity_logits" and of "log_scales" weighs the mean opacity and the mean scale (Kheradmand et
    al. 2024, MCMC); scales below the "least" of "log_scales", world units, are left alone: no photo tells
    them from 0, so that nothing else moves them, and Adam would take them down at full speed for ever. No
    moved splat is left longer than "max_aspect" of "log_scales" times its middle axis: the longest is cut.
    Means that are farther than the "far_from" of "means" times its "distance" from its "middle" (3,) move the
    faster, in proportion.

    A gradient that is NaN or above 1e18 counts as 0, and so does that of a parameter without one.
    """

    def __init__(
        self, splats: Splats, rates: Rates, *, max_aspect: float = math.inf, threads: int | None = None
    ) -> None:
        """`threads`: of the kernel; None: all cores. May be set at any time."""
        self.threads = threads
        more: dict[str, dict[str, Any]] = {
            "means": {"middle": (0.0, 0.0, 0.0), "distance": 1.0, "far_from": math.inf},
            "log_scales": {"reg": 0.0, "least": 0.0, "max_aspect": max_aspect},
            "opacity_logits": {"reg": 0.0},
            "sh": {"rest_divisor": REST_DIVISOR},
        }
        groups = [
            {"name": name, "params": [parameter], "lr": getattr(rates, name), **more.get(name, {})}
            for name, parameter in splats.named_parameters()
        ]
        super().__init__(groups, {})
        zeros = [Parameters(*(np.zeros_like(array) for array in splats.arrays)) for _ in range(2)]
        self.replace(splats, *zeros)

    add_param_group = _plain(Optimizer.add_param_group)
    zero_grad = _plain(Optimizer.zero_grad)

    @property
    def rates(self) -> Rates:
        """Learning rates of the next step."""
        return Rates(*(group["lr"] for group in self.param_groups))

    @rates.setter
    def rates(self, rates: Rates) -> None:
        for group, rate in zip(self.param_groups, rates, strict=True):
            group["lr"] = rate

    @property
    def steps(self) -> int:
        """Steps taken, by which bias is corrected."""
        return int(self._states()[0]["step"])

    @steps.setter
    def steps(self, steps: int) -> None:
        for state in self._states():
            state["step"] = steps

    @property
    def first(self) -> Parameters:
        """Running averages of the gradients, in the memory of the optimiser's state."""
        return Parameters(*(state["exp_avg"].numpy() for state in self._states()))

    @property
    def second(self) -> Parameters:
        """Running averages of the squared gradients, in the memory of the optimiser's state."""
        return Parameters(*(state["exp_avg_sq"].numpy() for state in self._states()))

    def set_options(self, name: str, **options: Any) -> None:
        """Sets options of an attribute's group."""
        next(group for group in self.param_groups if group["name"] == name).update(options)

    def replace(self, splats: Splats, first: Parameters, second: Parameters) -> None:
        """Goes on with parameters that were replaced, and with these averages, which are shared."""
        steps = self.steps if self.state else 0
        self.state.clear()
        for group, parameter, m, v in zip(self.param_groups, splats.parameters(), first, second, strict=True):
            group["params"] = [parameter]
            self.state[parameter] = {
                "step": steps,
                "exp_avg": torch.from_numpy(np.require(m, np.float32, ("C", "WRITEABLE"))),
                "exp_avg_sq": torch.from_numpy(np.require(v, np.float32, ("C", "WRITEABLE"))),
            }

    @torch.no_grad()
    def step(  # pyright: ignore[reportIncompatibleMethodOverride]
        self,
        visible: torch.Tensor | Sequence[np.ndarray] | None = None,
        closure: Callable[[], torch.Tensor] | None = None,
    ) -> torch.Tensor | None:
        """Moves the splats that `visible` names: a mask (N,) bool, indices (V,) that are distinct, or the
        `pieces` of a `Visibility`; None: all, those without a gradient by their averages.

        Returns the value of `closure`, which is called first, where there is one.
        """
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        parameters = [group["params"][0] for group in self.param_groups]
        states = [self.state[parameter] for parameter in parameters]
        step = int(states[0]["step"]) + 1
        for state in states:
            state["step"] = step
        threads = self.threads or available_threads()
        correction = np.sqrt(1 - BETA2**step)
        means, _, log_scales, opacity_logits, sh = self.param_groups
        rates = (*self.rates, sh["lr"] / sh["rest_divisor"])
        factors = np.array(rates, np.float32) * np.float32(correction / (1 - BETA1**step))
        count = max(len(parameters[0]), 1)
        limits = np.array(
            [
                opacity_logits["reg"] / count,
                log_scales["reg"] / 3 / count,
                log_scales["least"],
                math.log(log_scales["max_aspect"]),
                *means["middle"],
                1 / (means["far_from"] * means["distance"]),
            ]
        )
        run(
            move,
            [(indices,) for indices in pieces_of(visible, len(parameters[0]), threads) if len(indices)],
            (
                tuple(parameter.detach().view(-1).numpy() for parameter in parameters),
                tuple(_gradient(parameter) for parameter in parameters),
                tuple(state["exp_avg"].view(-1).numpy() for state in states),
                tuple(state["exp_avg_sq"].view(-1).numpy() for state in states),
                3 * parameters[-1].shape[1],
                factors,
                np.float32(EPSILON * correction),
                limits.astype(np.float32),
            ),
            threads,
        )
        # A picture that was drawn before cannot be differentiated by what the parameters are now.
        torch.autograd.graph.increment_version(parameters)
        return loss

    def _states(self) -> list[dict[str, Any]]:
        return [self.state[group["params"][0]] for group in self.param_groups]


def pieces_of(
    visible: torch.Tensor | Sequence[np.ndarray] | None, count: int, threads: int
) -> list[np.ndarray]:
    """What `SelectiveAdam.step` is given of `count` splats, as arrays of ascending indices (int32) to be
    shared out: none has any of the same SPLATS_PER_TASK splats as another.

    Raises:
        ValueError: a tensor is neither a mask (N,) nor indices (V,) within it.
    """
    if visible is None:
        indices = np.arange(count, dtype=np.int32)
    elif isinstance(visible, torch.Tensor):
        if visible.dtype == torch.bool:
            if visible.shape != (count,):
                raise ValueError(f"visible must have shape ({count},), got {tuple(visible.shape)}")
            visible = visible.nonzero()[:, 0]
        if visible.ndim != 1 or visible.is_floating_point():
            raise ValueError(f"visible must be a mask or indices, got {visible.dtype} {tuple(visible.shape)}")
        if len(visible) and not (visible.min() >= 0 and visible.max() < count):
            raise ValueError(f"visible must name splats from 0 to {count - 1}")
        indices = np.sort(visible.numpy()).astype(np.int32)
    else:
        indices = np.concatenate([np.empty(0, np.int32), *visible])
    ranges = even_ranges(count, threads * TASKS_PER_THREAD, step=SPLATS_PER_TASK)
    return np.split(indices, np.searchsorted(indices, [start for start, _ in ranges[1:]]))


def _gradient(parameter: torch.Tensor) -> np.ndarray:
    """Flat."""
    if parameter.grad is None:
        return np.zeros(parameter.numel(), np.float32)
    return parameter.grad.contiguous().view(-1).numpy()
