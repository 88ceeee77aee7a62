"""The end of a process in which a thread still compiles kernels."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import threading
import time
from numba.core.compiler_lock import global_compiler_lock
import splatview.scene.compiling

begun = threading.Event()

def compile_kernels():
    with global_compiler_lock:
        begun.set()
        time.sleep(0.3)
        print("compiled", flush=True)
    time.sleep(0.05)
    with global_compiler_lock:
        print("compiled another", flush=True)

threading.Thread(target=compile_kernels, daemon=True).start()
begun.wait()
"""


def test_the_end_waits_for_the_kernel_being_compiled_and_for_no_other() -> None:
    # numba holds this lock as long as LLVM works. A kernel in its stead would crash only some processes.
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=100, check=False
    )
    assert (done.returncode, done.stdout) == (0, "compiled\n"), done.stderr
