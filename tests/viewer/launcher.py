"""Runs the scripts that drive windows, each in a process of its own that begins with everything imported.

Half of a short test would be imports. One JSON object a line comes in (argv, env, cwd, output) and two lines
go out: the child's pid, and when it has ended its status as `os.waitpid` has it. Children are forked before
any thread, window or OpenGL context exists, and end as any interpreter does.
"""

from __future__ import annotations

import faulthandler
import json
import os
import runpy
import sys
from typing import Any


def child(job: dict[str, Any]) -> None:
    output = os.open(job["output"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    nothing = os.open(os.devnull, os.O_RDONLY)
    for here, there in ((nothing, 0), (output, 1), (output, 2)):
        os.dup2(here, there)
    os.environ.clear()
    os.environ.update(job["env"])
    os.chdir(job["cwd"])
    faulthandler.enable()  # on what is now standard error: a crash is told with the stacks of all threads
    sys.argv = job["argv"]
    runpy.run_path(sys.argv[0], run_name="__main__")


def serve() -> None:
    for line in iter(sys.stdin.readline, ""):
        pid = os.fork()
        if pid == 0:
            child(json.loads(line))
            return
        print(json.dumps(pid), flush=True)
        print(json.dumps(os.waitpid(pid, 0)[1]), flush=True)


if __name__ == "__main__":
    import drives  # noqa: F401  (what all scripts import)
    import torch  # noqa: F401

    import splatview.cli.train  # noqa: F401

    serve()
