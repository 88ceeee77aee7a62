"""One damaged file through one loader: what came of it, and whether that may be."""

from __future__ import annotations

import random
import resource
import signal
import traceback
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from loaders import Loader
from mutations import mutated, mutated_checkpoint
from packed_mutations import INSIDE

from splatview.scene import InputError

Outcome = Literal["loaded", "refused", "failed"]

SECONDS = 5.0
"""Of computing for one file of some KiB, which takes a millisecond: what takes so long hangs, or would on a
larger one."""

TIMES_THE_FILE = 4

SPARE_BYTES = 16 << 20
"""Of memory beyond four times the file. Readers take buffers of 1 MiB whatever the file's size, JSON takes up
to thirty times its text as Python's objects (files here have some KiB), and Pillow's decoders and the threads
that read photos have theirs; the highest seen is stated with the results."""

LONGEST_LINE = 1000
"""Characters of a message: the paths in it are some 60 each."""

ADDRESS_SPACE = 6 << 30
"""What the whole process may reserve: a loader that takes memory by a count in the file hits it."""


@dataclass(frozen=True)
class Result:
    outcome: Outcome
    what: str = ""
    """The message of a refusal, or why the trial failed."""
    grown: int = 0
    """Bytes that the process grew by at most while it loaded."""


class Trial:
    """Puts one file after the other before a loader, in a folder of its own."""

    def __init__(self, loader: Loader, folder: Path) -> None:
        self.loader, self.folder = loader, folder
        self.file = folder / loader.file
        self._late = False
        self._around = loader.around()
        self._set_up()

    def _set_up(self) -> None:
        for name, data in self._around.items():
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        self.file.parent.mkdir(parents=True, exist_ok=True)

    def __call__(self, data: bytes) -> Result:
        """Loads `data`. Only from the main thread: the time limit is a signal."""
        self.file.write_bytes(data)
        before = _peak_reset()
        self._late = False
        signal.signal(signal.SIGPROF, self._too_late)
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            with warnings.catch_warnings():
                # A user would see them as lines that say nothing.
                warnings.simplefilter("error", RuntimeWarning)
                # Pillow's, about damage that it passes over.
                warnings.simplefilter("ignore", UserWarning)
                loaded = self.loader.call(self.folder)
            result = Result("loaded" if loaded else "refused")
        except InputError as error:
            result = Result(
                "failed" if (wrong := _wrong_message(str(error))) else "refused", wrong or str(error)
            )
        except (KeyboardInterrupt, GeneratorExit):
            raise
        except BaseException:
            result = Result("failed", traceback.format_exc(limit=-6))
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        grown = max(_peak() - before, 0)
        if self._late:
            return Result("failed", f"computed for longer than {SECONDS:g} s", grown)
        if grown > TIMES_THE_FILE * len(data) + SPARE_BYTES:
            return Result("failed", f"took {grown:,} bytes for a file of {len(data):,}", grown)
        return Result(result.outcome, result.what, grown)

    def _too_late(self, *_: object) -> None:
        self._late = True
        raise TimeoutError


def _wrong_message(message: str) -> str | None:
    """What is wrong with a message that a user reads in a terminal; None if nothing is."""
    try:
        message.encode()
    except UnicodeEncodeError:
        return f"the message cannot be printed: {message!a}"
    if "memory" in message and "machine" in message and "GiB" not in message:
        return f"took all memory there was: {message!a}"
    if not message.strip() or len(message.splitlines()) != 1:
        return f"the message is not one line: {message!a}"
    if not all(character.isprintable() for character in message):
        return f"the message has characters that a terminal would obey: {message!a}"
    if len(message) > LONGEST_LINE:
        return f"the message has {len(message)} characters: {message[:200]!a}..."
    return None


def _peak_reset() -> int:
    """Bytes of the process now; the peak counts from here on."""
    with open("/proc/self/clear_refs", "w") as file:
        file.write("5")
    return _status("VmRSS:")


def _peak() -> int:
    return _status("VmHWM:")


def _status(key: str) -> int:
    with open("/proc/self/status", "rb") as file:
        text = file.read()
    return int(text[text.index(key.encode()) :].split(maxsplit=2)[1]) * 1024


def damaged_file(loader: Loader, corpus: Sequence[bytes], seed: int) -> bytes:
    """The file number `seed` for a loader: the same whenever its corpus is."""
    rng = random.Random(seed)
    inside = INSIDE.get(loader.name)
    if inside is not None and rng.random() < 0.6:
        return inside(rng, rng.choice(list(loader.seeds())))
    if loader.name == "checkpoint" and rng.random() < 0.5:
        return mutated_checkpoint(rng, corpus, lambda text: mutated(rng, [text], ()))
    return mutated(rng, corpus, loader.words)


def limit_memory() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
