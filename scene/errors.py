"""The one exception that means "the user's input is at fault"."""

from __future__ import annotations


class InputError(ValueError):
    """Something the user gave cannot be used.

    The message is one line that says what, where and what to do; the command line prints it
    after ``splatview:`` and exits with code 2, the window shows it in a dialog. Anything else
    that escapes is a defect of ours and keeps its traceback.
    """
