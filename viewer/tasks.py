"""Work beside the frame loop: every background thread of the window is a `Task`."""

from __future__ import annotations

import operator
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Result = TypeVar("Result")
Request = TypeVar("Request")


class Task(Generic[Result]):
    """One run of `work(task)` in a thread of its own, begun at once. Readable from any thread."""

    progress: float = 0.0
    """Share of the work that is done, 0 to 1; below 0 where it is unknown."""
    text: str = ""
    """Description of the step under way."""

    def __init__(
        self,
        work: Callable[[Task[Result]], Result],
        *,
        name: str = "splatview-task",
        on_done: Callable[[], object] = lambda: None,
    ):
        """`on_done` is called in the thread when the work has ended, failed or been cancelled."""
        self.result: Result | None = None
        self.error: BaseException | None = None
        """Exception that ended the work."""
        self.done = False
        """Whether the work has ended, in whatever way."""
        self._work, self._on_done = work, on_done
        self._cancelled = threading.Event()
        # A daemon: a read that hangs on a dead network drive must not keep the program from ending.
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def cancelled(self) -> bool:
        return self._cancelled.is_set()

    def cancel(self) -> None:
        """Asks the work to end soon; its result is not to be used."""
        self._cancelled.set()

    def report(self, share: float, text: str = "") -> None:
        """Progress, for `work` to call."""
        self.progress, self.text = share, text

    def join(self, timeout: float | None = None) -> None:
        """Waits until the thread has ended, at most `timeout` seconds."""
        self._thread.join(timeout)

    def _run(self) -> None:
        try:
            self.result = self._work(self)
        except BaseException as error:
            # An error is for the GL thread to report.
            self.error = error
        finally:
            self.done = True
            self._on_done()


class LatestTask(Generic[Request, Result]):
    """Work on the latest of many requests, one at a time: of requests that come meanwhile only the last
    is worked on. For the GL thread."""

    def __init__(
        self,
        work: Callable[[Request, Task[Result]], Result],
        *,
        name: str = "splatview-latest",
        same: Callable[[Request, Request], bool] = operator.eq,
        on_done: Callable[[], object] = lambda: None,
    ):
        """`same` tells whether two requests have one result; `on_done` is called in the thread after each
        run. A run that cancels its own task leaves result and problem as they were."""
        self.latest: Result | None = None
        """Result of the last run that succeeded."""
        self.problem: str | None = None
        """Error of the last run, in one line."""
        self._work, self._name, self._same, self._on_done = work, name, same, on_done
        self._task: Task[Result] | None = None
        self._tried: Request | None = None

    @property
    def busy(self) -> bool:
        return self._task is not None

    def has_tried(self, request: Request) -> bool:
        """Whether the last run was for `request`."""
        return self._tried is not None and self._same(request, self._tried)

    def request(self, request: Request) -> None:
        """Starts work on `request` unless something is under way or it was worked on last; may be called in
        every frame."""
        self.collect()
        if self._task is None and not self.has_tried(request):
            self._tried, self.problem = request, None
            self._task = Task(lambda task: self._work(request, task), name=self._name, on_done=self._on_done)

    def collect(self) -> None:
        """Takes over the result of a run that has ended."""
        task = self._task
        if task is None or not task.done:
            return
        self._task = None
        if task.cancelled:
            return
        if task.error is not None:
            self.problem = f"{type(task.error).__name__}: {task.error}"
        else:
            self.latest = task.result

    def close(self) -> None:
        """Cancels the run under way and waits for its end."""
        if self._task is not None:
            self._task.cancel()
            self._task.join()
            self._task = None
