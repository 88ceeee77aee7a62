"""The `splatview` command: finds the command that is asked for and turns its errors into one line.

Nothing heavy is imported here: each command is a module of `commands`, imported when it is asked for.
"""

from __future__ import annotations

import contextlib
import difflib
import importlib
import io
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, TextIO

from splatview.scene import InputError
from splatview.scene.errors import printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

COMMANDS = {
    "render": "a scene to a picture file, without a window",
    "film": "a camera's way through a scene to a video, a GIF or PNG files",
    "info": "what a scene holds, which effects it calls for, and its health",
    "stability": "hard cases on every renderer of this machine, against the reference",
    "ladder": "what accuracy costs in time: each shortcut's price, measured",
    "bill": "what a picture takes in arithmetic and bytes, beside a NeRF",
    "train": "photos with known cameras to a scene",
    "edit": "the steps of a recipe, done to a scene",
    "convert": "a scene to another format",
    "doctor": "what works on this machine and what to install",
}
"""Name -> summary. Each is a module of `cli` with `run(arguments) -> exit code`."""

MODULES = {"bill": "work"}
"""Commands whose module has another name."""

USAGE = """\
usage: splatview [SCENE ...]          open a window (no scene: the bundled demo; a folder: its frames)
       splatview COMMAND ...          see splatview COMMAND --help

commands:
{commands}
options of the window:
  --renderer {renderers:24} what draws (default: auto)
  --merge                             one scene of all files, also where they are numbered as frames
  -o, --output FILE.png               where there is no display: name of the preview written instead
  --version                           print the version

A scene called like a command is opened by its path: splatview ./render"""

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
EXIT_BROKEN_PIPE = 141
"""128 + SIGINT and 128 + SIGPIPE, as shells report them."""


def main(argv: Sequence[str] | None = None, *, on_loaded: Callable[[], None] = lambda: None) -> int:
    """Runs `splatview` with `argv` (default: the process's); returns the exit code. `on_loaded` is called
    between the import of the command and its work.

    A user's mistake (InputError) is one line on standard error and exit code 2. Any other exception is a
    defect of ours and keeps its traceback.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    output, messages = TolerantStream(sys.stdout), TolerantStream(sys.stderr)
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(messages):  # pyright: ignore
        try:
            code = _dispatch(arguments, on_loaded)
        except InputError as error:
            print("splatview:", " ".join(str(error).split("\n")), file=sys.stderr)
            code = EXIT_BAD_INPUT
        except MemoryError as error:
            print(f"splatview: not enough memory ({error}); try a smaller scene or --size", file=sys.stderr)
            code = EXIT_BAD_INPUT
        except KeyboardInterrupt:
            code = EXIT_INTERRUPTED
        finally:
            # Noticed here rather than in the interpreter's shutdown, which would complain.
            output.flush()
            messages.flush()
        if code == 0 and isinstance(output.failure, BrokenPipeError):
            return EXIT_BROKEN_PIPE
        if code == 0 and isinstance(output.failure, OSError):
            reason = output.failure.strerror or output.failure
            print(f"splatview: standard output: cannot be written: {reason}", file=sys.stderr)
            return EXIT_BAD_INPUT
    return code


class TolerantStream:
    """A standard stream to which writing never fails: work is worth more than what is said about it. Lines
    are shown as they are: what a terminal would obey is written as escapes.

    A reader that has gone (``| head``), a full disk under a log and a stream that was closed from the start
    are noted once, in `failure`; what is written after that goes nowhere. Characters that the stream's
    encoding lacks are written as escapes.
    """

    def __init__(self, stream: TextIO | None) -> None:
        """`stream`: None where the process was started without it."""
        self._stream = stream
        self.failure: Exception | None = None
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")

    def write(self, text: str) -> int:
        self.write_styled(printable(text, keep="\n\t"))
        return len(text)

    def write_styled(self, text: str) -> None:
        """Writes `text` with what the terminal shall obey."""
        self._try(lambda stream: stream.write(text))

    def flush(self) -> None:
        self._try(lambda stream: stream.flush())

    def isatty(self) -> bool:
        return self._stream is not None and self._stream.isatty()

    def __getattr__(self, name: str) -> Any:
        if self._stream is None:
            raise AttributeError(name)
        return getattr(self._stream, name)

    def _try(self, act: Callable[[TextIO], object]) -> None:
        if self._stream is None or self.failure is not None:
            return
        try:
            act(self._stream)
        except (OSError, ValueError) as error:  # ValueError: it was closed on the way
            self.failure = error
            with contextlib.suppress(OSError, ValueError):
                # What is still buffered must go somewhere when the interpreter flushes it.
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())


class _Styled:
    """A `TolerantStream` to which a library writes its own colours and moves of the cursor."""

    def __init__(self, stream: TolerantStream) -> None:
        self._stream = stream

    def write(self, text: str) -> None:
        self._stream.write_styled(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def make_console(*, stderr: bool = True, quiet: bool = False) -> Console:
    """A console for tables and bars. Texts are shown as they are: nothing in them is markup, or obeyed."""
    from rich.console import Console

    class PlainConsole(Console):
        def render_str(self, text: str, **options: Any) -> Text:
            return super().render_str(printable(text, keep="\n\t"), **options)

    stream = sys.stderr if stderr else sys.stdout
    file: Any = _Styled(stream) if isinstance(stream, TolerantStream) else stream
    return PlainConsole(file=file, quiet=quiet, markup=False, emoji=False, highlight=False)


def no_window() -> str | None:
    """One line on why no window can be opened, or None."""
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        # Known without loading the window's libraries.
        return "no display (neither DISPLAY nor WAYLAND_DISPLAY is set)"
    from splatview.viewer.platform import display_problem

    return display_problem()


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """The end of a message about a `word` that is none of `known`; "" where none is like it."""
    like = difflib.get_close_matches(word, list(known), n=1)
    return f"; did you mean {like[0]}?" if like else ""


def _dispatch(arguments: list[str], on_loaded: Callable[[], None]) -> int:
    first = arguments[0] if arguments else ""
    if first in ("-h", "--help", "help"):
        commands = "".join(f"  {name:34}  {summary}\n" for name, summary in COMMANDS.items())
        from splatview.renderers import choices

        print(USAGE.format(commands=commands, renderers="|".join(("auto", *choices("window")))))
        return 0
    if first == "--version":
        print("splatview", version("splatview"))
        return 0
    if first in COMMANDS:
        name, arguments = MODULES.get(first, first), arguments[1:]
    elif first.isalpha() and not os.path.lexists(first) and (meant := did_you_mean(first, COMMANDS)):
        raise InputError(f"{first}: no such file, nor a command{meant}")
    else:
        name = "window"
    command = importlib.import_module(f"splatview.cli.{name}")
    on_loaded()
    return command.run(arguments)
