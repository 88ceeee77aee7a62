"""Has pictures rehearsed in the background, and knows which have been.

One at a time of the GPU's and one of the CPU's: kernels take many times as long as programs.
"""

from __future__ import annotations

import contextlib
import pickle
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from .rehearsal import Rehearsal

LONGEST = 300.0
"""Seconds after which a rehearsal is given up."""

MOST_REMEMBERED = 5000
"""Lines of the file that remembers; then it begins anew."""

STARTER = "from splatview.viewer.gl.rehearsal import main; main()"


@dataclass(frozen=True)
class _Task:
    keys: frozenset[str]
    title: str
    rehearsal: Rehearsal


class Rehearsals:
    """Knows by keys what is compiled. All methods may be called from any thread.

    `memory`: a file that keeps the keys of earlier sessions, as caches on disk outlive them. `on_change` is
    called, in another thread, when something has been compiled.
    """

    def __init__(
        self,
        *,
        memory: Path | None = None,
        gl_version: tuple[int, int] | None = None,
        on_change: Callable[[], object] = lambda: None,
        perform: Callable[[Rehearsal], None] | None = None,
    ) -> None:
        self.gl_version = gl_version
        """Of the windows to draw in; None: without one."""
        self._memory = memory
        self._on_change = on_change
        self._perform = perform or self._in_a_process
        self._change = threading.Condition()
        # Guarded by _change:
        self._done = remembered(memory)
        self._asked: set[str] = set()
        self._titles: dict[bool, str] = {}
        self._problem: str | None = None
        self._ended = False
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._tasks: dict[bool, queue.SimpleQueue[_Task | None]] = {}
        """By whether the CPU draws; each has a thread."""

    def is_done(self, keys: Iterable[str]) -> bool:
        """Whether there is nothing to wait for: all is compiled, or cannot be in the background."""
        with self._change:
            return self._ended or self._done.issuperset(keys)

    def ask(self, keys: Iterable[str], title: str, rehearsal: Callable[[], Rehearsal]) -> None:
        """Has `keys` compiled by a rehearsal, unless that has been asked for; `title` tells the user what
        is compiled."""
        with self._change:
            missing = frozenset(keys) - self._done - self._asked
            if not missing or self._ended:
                return
            self._asked |= missing
            task = _Task(missing, title, rehearsal())
            by_cpu = task.rehearsal.renderer == "cpu"
            if by_cpu not in self._tasks:
                self._tasks[by_cpu] = queue.SimpleQueue()
                threading.Thread(
                    target=self._work, args=(by_cpu,), name="splatview-rehearsals", daemon=True
                ).start()
            self._tasks[by_cpu].put(task)

    def note(self, keys: Iterable[str]) -> None:
        """`keys` have been compiled otherwise."""
        with self._change:
            new = frozenset(keys) - self._done
            self._done |= new
            self._change.notify_all()
        self._remember(new)

    def wait(self, keys: Iterable[str]) -> bool:
        """Returns True when `is_done`, False when all has ended before."""
        keys = frozenset(keys)
        with self._change:
            self._change.wait_for(lambda: self._ended or self._done.issuperset(keys))
            return self._done.issuperset(keys)

    @property
    def title(self) -> str:
        """What is being compiled, or ""."""
        with self._change:
            return ", ".join(self._titles.values())

    def take_problem(self) -> str | None:
        """Why something could not be compiled in the background, once."""
        with self._change:
            problem, self._problem = self._problem, None
            return problem

    def release(self) -> None:
        """Nothing is waited for any more; a process that is at work is ended."""
        with self._change:
            self._ended = True
            self._change.notify_all()
            for process in self._processes:
                process.terminate()
            for tasks in self._tasks.values():
                tasks.put(None)

    def _work(self, by_cpu: bool) -> None:
        while True:
            task = self._tasks[by_cpu].get()
            if task is None or self._ended:
                return
            with self._change:
                self._titles[by_cpu] = task.title
            self._on_change()
            problem: str | None = None
            try:
                self._perform(task.rehearsal)
            except Exception as error:
                if self._ended:
                    return
                # What is not compiled ahead is compiled when it is needed: slower, and no harm.
                problem = f"{task.title} cannot be compiled in the background: {error}"
            if problem is None:
                self._remember(task.keys)
            with self._change:
                del self._titles[by_cpu]
                self._problem = problem or self._problem
                self._done |= task.keys
                self._change.notify_all()
            self._on_change()

    def _in_a_process(self, rehearsal: Rehearsal) -> None:
        def started(process: subprocess.Popen[bytes]) -> None:
            with self._change:
                self._processes.add(process)
                if self._ended:
                    process.terminate()

        try:
            in_a_process(rehearsal, started)
        finally:
            with self._change:
                self._processes = {process for process in self._processes if process.poll() is None}

    def _remember(self, keys: Iterable[str]) -> None:
        if self._memory is None or not keys:
            return
        with contextlib.suppress(OSError):  # a disk that cannot be written costs only time
            self._memory.parent.mkdir(parents=True, exist_ok=True)
            with self._memory.open("a", encoding="utf8") as file:
                file.writelines(f"{key}\n" for key in sorted(keys))


def remembered(memory: Path | None) -> set[str]:
    """The keys in the file, none where there is none or it has grown too long."""
    if memory is None:
        return set()
    try:
        lines = memory.read_text(encoding="utf8").splitlines()
        if len(lines) > MOST_REMEMBERED:
            memory.unlink()
            return set()
    except (OSError, UnicodeDecodeError):
        return set()
    return set(lines)


def in_a_process(
    rehearsal: Rehearsal, on_start: Callable[[subprocess.Popen[bytes]], object] = lambda process: None
) -> None:
    """Returns when it has been performed.

    Raises:
        RuntimeError: it has not; says what the process said last.
    """
    try:
        process = subprocess.Popen(
            [sys.executable, "-c", STARTER],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
    except OSError as error:
        raise RuntimeError(str(error)) from error
    on_start(process)
    try:
        _, said = process.communicate(pickle.dumps(rehearsal), timeout=LONGEST)
    except subprocess.TimeoutExpired as error:
        process.kill()
        process.communicate()
        raise RuntimeError(f"not done after {LONGEST:.0f} s") from error
    if process.returncode != 0:
        lines = said.decode(errors="replace").strip().splitlines()
        raise RuntimeError(lines[-1] if lines else f"exit code {process.returncode}")
