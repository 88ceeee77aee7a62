"""Checkpoints: a run as it stands in one .safetensors file, from which it goes on bit for bit."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from splatview.raster import Parameters
from splatview.raster.parameters import check_parameters
from splatview.scene import InputError
from splatview.scene.formats.io import atomic_write, require_regular_file
from splatview.trainer.counters import Counters
from splatview.trainer.settings import TrainSettings, from_recorded, recorded

if TYPE_CHECKING:
    from splatview.trainer.trainer import Trainer

FORMAT = "splatview checkpoint 1"

GROUPS = ("parameters", "first", "second")
"""The splats and Adam's two averages, by the first part of their names in the file."""

REFINED = ("refined_at", "refined_progress")
"""What of a strategy's state is among the counters in the file."""

ELSEWHERE = ("extent", "focal", *REFINED)
"""What of a strategy's state is no array of its own in the file."""

STATE_NAMES = {"gradient_sums": "pulled", "view_counts": "seen", "sky": "sky", "frozen": "frozen"}
"""Names in the file of the state's arrays that have a row for each splat."""


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """What a file holds, checked."""

    settings: TrainSettings
    counters: Counters
    extent: float
    centre: np.ndarray
    """(3,) float64: what the means are relative to, see `Trainer`."""
    parameters: Parameters
    first: Parameters
    """Adam's running average of the gradient, in the shapes of `parameters`."""
    second: Parameters
    """Adam's running average of the squared gradient."""
    ids: np.ndarray
    """(N,) int64, see `Splats.ids`."""
    next_id: int
    state: dict[str, Any]
    """State of the strategy, but for what the capture says."""
    exposure: dict[str, np.ndarray]
    """Arrays of the photos' exposures, see `Exposures.state`."""
    shading: dict[str, np.ndarray]
    """Arrays of the photos' shading, see `Shadings.state`; none in older files."""
    evidence: dict[str, np.ndarray]
    """Arrays of what the run has found out about itself; none in older files."""
    scenes: dict[str, np.ndarray]
    """Arrays of the scenes before the present one, see `ensemble`; none where there are none."""
    photos: list[list[Any]]
    """[name, width, height] of each photo trained on, in order."""
    notes: dict[str, Any]
    """What the program that trains wants to remember."""


def save_checkpoint(trainer: Trainer, path: Path, notes: dict[str, Any] | None = None) -> None:
    """Writes the run, wholly or not at all: whatever happens, the old file or the new one is there.

    Raises:
        InputError: the operating system refuses.
    """
    splats, optimizer, state = trainer.splats, trainer.optimizer, trainer.state
    arrays = {
        f"{group}.{name}": np.ascontiguousarray(array)
        for group, values in zip(GROUPS, (splats.arrays, optimizer.first, optimizer.second), strict=True)
        for name, array in values._asdict().items()
    }
    arrays["ids"] = splats.ids
    for name, value in state.items():
        if name not in ELSEWHERE:
            arrays[f"control.{STATE_NAMES.get(name, name)}"] = np.atleast_1d(value)
    arrays |= {f"exposure.{name}": array for name, array in trainer.exposures.state().items()}
    arrays |= {f"shading.{name}": array for name, array in trainer.shadings.state().items()}
    evidence = trainer.resolution.state() | trainer.outliers.state() | trainer.transients.state()
    evidence["nearest_depths"] = trainer.nearest_depths
    means = optimizer.param_groups[0]
    evidence["usual"] = np.array([*means["middle"], means["distance"]])
    arrays |= {f"evidence.{name}": array for name, array in evidence.items()}
    arrays |= {f"scenes.{name}": array for name, array in trainer.scenes_state().items()}
    description = {
        "settings": recorded(trainer.settings),
        "counters": asdict(trainer.counters) | {name: state[name] for name in REFINED},
        "extent": trainer.extent,
        "next_id": splats.next_id,
        "photos": trainer.views.names(),
        "notes": notes or {},
    }
    if trainer.centre.any():
        description["centre"] = trainer.centre.tolist()
    data = save(arrays, metadata={"format": FORMAT, "run": json.dumps(description)})
    with atomic_write(path) as file:
        file.write(data)


def load_checkpoint(path: Path) -> Checkpoint:
    """Raises InputError: the file is missing, damaged, or no checkpoint of ours."""
    require_regular_file(path)
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            if metadata.get("format") != FORMAT:
                raise InputError(f"{path}: is not a splatview checkpoint")
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 not a dict
        return _checked(json.loads(metadata["run"]), arrays)
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path}: is not a checkpoint that can be read: {error}") from None
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: damaged checkpoint: {error}") from None


def restore(trainer: Trainer, checkpoint: Checkpoint) -> None:
    """Puts a trainer of the same photos where the checkpoint's was.

    Raises:
        InputError: the photos are others.
    """
    from splatview.trainer.ensemble import EnsembleTrainer  # which needs torch

    ours, theirs = trainer.views.names(), checkpoint.photos
    if ours != theirs:
        names, known = ({name for name, *_ in photos} for photos in (ours, theirs))
        if lost := sorted(known - names):
            about = f"{lost[0]} is not among them now"
        elif more := sorted(names - known):
            about = f"{more[0]} is among them now"
        else:
            name, *size = next((a for a, b in zip(ours, theirs, strict=False) if a != b), ours[0])
            about = f"{name} is {size[0]}x{size[1]} now"
        raise InputError(
            f"the checkpoint was trained on other photos ({about});"
            " resume with the same capture and --downscale"
        )
    splats, optimizer = trainer.splats, trainer.optimizer
    splats.replace(checkpoint.parameters, checkpoint.ids)
    splats.next_id = checkpoint.next_id
    optimizer.replace(splats, checkpoint.first, checkpoint.second)
    shift = checkpoint.centre - trainer.centre
    if shift.any():  # written before captures far from the origin were trained about a centre
        means = splats.arrays.means
        means[:] = means + shift
    trainer.counters = replace(checkpoint.counters)
    optimizer.steps = checkpoint.counters.iteration
    trainer.extent = checkpoint.extent
    trainer.state |= checkpoint.state | {"extent": checkpoint.extent}
    try:
        trainer.exposures.restore(checkpoint.exposure)
        trainer.shadings.restore(checkpoint.shading)
    except (KeyError, ValueError) as error:
        raise InputError(
            f"the checkpoint's exposures are not those of its photos: {error}; it is damaged"
        ) from None
    if "progressive" in checkpoint.evidence:
        trainer.resolution.restore(checkpoint.evidence)
    if "outliers" in checkpoint.evidence:
        trainer.outliers.restore(checkpoint.evidence)
        trainer.leave_out(trainer.outliers.left_out)
    if "transients" in checkpoint.evidence:
        trainer.transients.restore(checkpoint.evidence)
    trainer.mask()
    trainer.nearest_depths = checkpoint.evidence.get("nearest_depths", np.zeros(len(ours)))
    if trainer.nearest_depths.shape != (len(ours),):
        raise InputError("the checkpoint's depths are not as many as its photos; it is damaged")
    usual = checkpoint.evidence.get("usual", np.array([0.0, 0.0, 0.0, 1.0]))
    if usual.shape != (4,) or not np.isfinite(usual).all() or not usual[3] > 0:
        raise InputError("the checkpoint's middle and distance of the scene are none; it is damaged")
    optimizer.set_options("means", middle=usual[:3], distance=float(usual[3]))
    if isinstance(trainer, EnsembleTrainer) and checkpoint.scenes:
        trainer.restore_scenes(checkpoint.scenes)


def _under(prefix: str, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Those whose names begin so, by the rest of their names."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _checked(run: dict[str, Any], arrays: dict[str, np.ndarray]) -> Checkpoint:
    groups = [
        check_parameters(**{name: arrays[f"{group}.{name}"] for name in Parameters._fields})
        for group in GROUPS
    ]
    for group in groups:
        if [array.shape for array in group] != [array.shape for array in groups[0]]:
            raise ValueError("its arrays differ in length")
        if not all(array.dtype == np.float32 for array in group):
            raise ValueError("its arrays are not float32")
    ids, next_id = arrays["ids"], int(run["next_id"])
    if ids.dtype != np.int64 or ids.shape != groups[0].opacity_logits.shape:
        raise ValueError("its splats are not numbered as they should be")
    if len(np.unique(ids)) != len(ids) or not (ids < next_id).all():
        raise ValueError("its splats are not numbered as they should be")
    centre = np.array(run.get("centre", (0, 0, 0)), np.float64)
    if centre.shape != (3,) or not np.isfinite(centre).all():
        raise ValueError(f"its centre must be 3 finite numbers, not {centre}")
    settings, counters = from_recorded(run["settings"]), dict(run["counters"])
    # Older files have no word about it, as all steps looked at as many.
    counters.setdefault("photos", counters["iteration"] * settings.batch)
    state: dict[str, Any] = {"refined_at": int(counters.pop("refined_at", 0))}
    state["refined_progress"] = float(counters.pop("refined_progress", 0.0))
    ours = {theirs: name for name, theirs in STATE_NAMES.items()}
    for name, array in _under("control.", arrays).items():
        # A number is an array of one element; only arrays by splat have other names.
        state[ours.get(name, name)] = array if name in ours else array.reshape(-1)[0].item()
    if any(isinstance(value, np.ndarray) and value.shape != ids.shape for value in state.values()):
        raise ValueError("its strategy's arrays are not as long as its splats")
    scenes = _under("scenes.", arrays)
    for place in {name.split(".")[0] for name in scenes if "." in name}:
        check_parameters(**{name: scenes[f"{place}.{name}"] for name in Parameters._fields})
    return Checkpoint(
        settings=settings,
        counters=Counters(**counters),
        extent=float(run["extent"]),
        centre=centre,
        parameters=groups[0],
        first=groups[1],
        second=groups[2],
        ids=ids,
        next_id=next_id,
        state=state,
        exposure=_under("exposure.", arrays),
        shading=_under("shading.", arrays),
        evidence=_under("evidence.", arrays),
        scenes=scenes,
        photos=[list(photo) for photo in run["photos"]],
        notes=dict(run["notes"]),
    )
