"""Several processes train one scene: each looks at its share of a batch's photos, and all take the same step.

What is added up over processes is the gradients (all-reduce) and what density control notes of a step;
everything else is computed alike everywhere from equal seeds, so that parameters never need to be sent. The
processes are those of ``torchrun``, on one machine or several, and talk by gloo.
"""

from __future__ import annotations

import hashlib
import os
import signal
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn, Protocol

import numpy as np

from splatview.raster.compiling import TASKS_PER_THREAD, available_threads
from splatview.scene import InputError


class PeerLost(InputError):
    """Another process of the run has ended; this one's scene is as it was before the step."""


class Group(Protocol):
    """The processes of a run, as one of them sees them. All must make the same calls in the same order."""

    rank: int
    """Number of this process, 0 to size - 1; 0 is the one that writes."""
    size: int
    stopping: bool
    """Whether this process was asked to stop; see `agreed`."""

    def add_up(self, arrays: Sequence[np.ndarray]) -> None:
        """Each array becomes, in place and everywhere, its sum over the processes. Raises PeerLost."""

    def agreed(self, seconds: float) -> float:
        """The first process's value, everywhere.

        Raises:
            KeyboardInterrupt: in all processes alike, once any was asked to stop.
            PeerLost: another process is gone.
        """
        ...

    def leave(self) -> None:
        """Ends the connections, at the end of the run."""


class Alone:
    """A run of one process."""

    rank, size = 0, 1

    def __init__(self) -> None:
        self.stopping = False

    def add_up(self, arrays: Sequence[np.ndarray]) -> None:
        """There is nothing to add."""

    def agreed(self, seconds: float) -> float:
        if self.stopping:
            raise KeyboardInterrupt
        return seconds

    def leave(self) -> None:
        """There is nobody to leave."""


class Processes:
    """A run of several, started by torchrun."""

    def __init__(self) -> None:
        """Meets the others. Raises InputError where they cannot be reached."""
        try:
            import torch
            import torch.distributed
        except ImportError:
            raise InputError(
                "several processes talk by torch, which is not installed: pip install 'splatview[train]'"
            ) from None
        # Its own threads would wait in loops on the cores that the kernels work on.
        torch.set_num_threads(1)
        self._torch, self._distributed = torch, torch.distributed
        try:
            torch.distributed.init_process_group("gloo")
        except (RuntimeError, ValueError) as error:
            raise InputError(
                f"the other processes cannot be reached ({gist(error)}); start them with torchrun"
            ) from None
        self.rank = torch.distributed.get_rank()
        self.size = torch.distributed.get_world_size()
        self.stopping = False

    def add_up(self, arrays: Sequence[np.ndarray]) -> None:
        for array in arrays:
            try:
                self._distributed.all_reduce(self._torch.from_numpy(array))
            except RuntimeError as error:
                self._lost(error)

    def agreed(self, seconds: float) -> float:
        said = np.array([seconds if self.rank == 0 else 0.0, float(self.stopping)])
        self.add_up([said])
        if said[1] > 0:
            raise KeyboardInterrupt
        return float(said[0])

    def gathered(self, value: Any) -> list[Any]:
        """Everybody's `value`, by rank: plain data. Raises PeerLost."""
        values: list[Any] = [None] * self.size
        try:
            self._distributed.all_gather_object(values, value)
        except RuntimeError as error:
            self._lost(error)
        return values

    def leave(self) -> None:
        # Without this the interpreter's end would be an abort.
        self._distributed.destroy_process_group()

    def _lost(self, error: RuntimeError) -> NoReturn:
        raise PeerLost(
            f"process {self.rank} of {self.size} stops, for another one has ended ({gist(error)})"
        ) from None


def gist(error: Exception) -> str:
    """The gist of torch's messages, which go on with advice and begin with addresses of code."""
    return str(error).partition("\n")[0].partition(". ")[0].rpartition("] ")[2].rstrip(".")


@contextmanager
def stopping_between_steps(group: Group) -> Iterator[None]:
    """Within, SIGINT, SIGTERM and SIGHUP (a terminal that is closed; unless it is ignored, as nohup does) end
    the run after a step, in all processes after the same one.

    In the middle of a step they would leave a scene half moved, or other processes waiting. A run of one
    process obeys the second SIGINT at once. One of several does not: torchrun passes on what it gets
    besides, which is not to end the writing of the scene.
    """

    def stop(number: int, frame: Any) -> None:
        if group.stopping and group.size == 1:
            raise KeyboardInterrupt
        group.stopping = True

    numbers = [signal.SIGINT, signal.SIGTERM]
    hangup = getattr(signal, "SIGHUP", None)
    if hangup is not None and signal.getsignal(hangup) is not signal.SIG_IGN:
        numbers.append(hangup)
    before = {number: signal.signal(number, stop) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def is_launched() -> bool:
    """Whether torchrun started this process as one of several."""
    return "RANK" in os.environ and os.environ.get("WORLD_SIZE", "1") != "1"


def share_of_cores() -> int:
    """Threads for each of the processes on this machine."""
    return max(available_threads() // local_processes(), 1)


def local_processes() -> int:
    """Processes of the run on this machine."""
    return int(os.environ.get("LOCAL_WORLD_SIZE", "1"))


def digest(*parts: Any) -> str:
    """SHA-256 of arrays and plain values; equal digests mean equal parts."""
    made = hashlib.sha256()
    for part in parts:
        made.update(part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode())
    return made.hexdigest()


def check_equal(group: Processes, parts: dict[str, str]) -> None:
    """Compares a digest of everything that must be the same everywhere, by what it is called.

    Raises:
        InputError: one differs, in every process alike.
    """
    everybody = group.gathered(parts)
    for rank, theirs in enumerate(everybody):
        for name, value in everybody[0].items():
            if theirs.get(name) != value:
                raise InputError(
                    f"process {rank} of {group.size} has other {name} than process 0;"
                    " all must be given the same capture and options"
                )


class BatchSum:
    """Gradients of a batch's photos, added up over photos and then over processes: in one piece of memory, on
    which autograd adds them up."""

    def __init__(self, parameters: Iterable[Any]) -> None:
        """`parameters`: torch's, whose gradients from now on are parts of this, 0 at first."""
        import torch

        parameters = list(parameters)
        ends = np.cumsum([parameter.numel() for parameter in parameters])
        self._flat = np.zeros(ends[-1], np.float32)
        for parameter, piece in zip(parameters, np.split(self._flat, ends[:-1]), strict=True):
            parameter.grad = torch.from_numpy(piece.reshape(parameter.shape))
        self._visible = np.zeros(len(parameters[0]), np.int32)
        self._loss = np.zeros(1)

    def add(self, visible: Sequence[np.ndarray], loss: float) -> None:
        """One photo's, besides the gradients."""
        for indices in visible:
            self._visible[indices] = 1
        self._loss += loss

    def means(self, photos: int, group: Group, threads: int) -> tuple[list[np.ndarray], float]:
        """Makes the gradients means over `photos` of all processes; splats visible in any (int32), and the
        mean loss."""
        group.add_up([self._flat, self._visible, self._loss])
        self._flat *= np.float32(1 / photos)
        visible = np.flatnonzero(self._visible).astype(np.int32)
        return np.array_split(visible, threads * TASKS_PER_THREAD), float(self._loss[0]) / photos
