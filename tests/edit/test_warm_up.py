"""After warming up, quick edits compile nothing."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
from splatview.edit.kernels import marks
from splatview.edit.warm_up import warm_up

warm_up()
kernels = [value for value in vars(marks).values() if hasattr(value, "signatures")]
kernels.remove(marks.place)  # a part of others
print(len(kernels), sorted(kernel.__name__ for kernel in kernels if not kernel.signatures))
"""


def test_every_kernel_over_marks_is_compiled():
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=250
    )
    count, missed = run.stdout.split(" ", 1)
    assert int(count) >= 10
    assert missed.strip() == "[]"
