"""Nothing that lies in the current folder is run, whatever it is called."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from splatview.renderers.precompile import STARTER, in_a_process

TRAPS = ("numpy", "moderngl", "numba", "PIL", "json", "pickle")


@pytest.fixture
def folder_with_traps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in TRAPS:
        code = f"open({str(tmp_path / 'ran')!r}, 'a').write({name!r})\nraise SystemExit(9)\n"
        (tmp_path / f"{name}.py").write_text(code)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_precompiler_s_processes_do_not_import_from_it(folder_with_traps):
    # Not a job: the process ends with an error of its own, after all of its imports.
    with pytest.raises(RuntimeError):
        in_a_process("no job")  # pyright: ignore[reportArgumentType]
    assert not (folder_with_traps / "ran").exists()


def test_the_traps_would_have_been_sprung(folder_with_traps):
    subprocess.run([sys.executable, "-c", STARTER], input=b"", capture_output=True, check=False)
    assert (folder_with_traps / "ran").exists()


def test_doctor_does_not_import_from_it(folder_with_traps):
    command = Path(sys.executable).with_name("splatview")
    if not command.exists():
        pytest.skip("splatview is not installed as a command here")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run([command, "doctor"], env=environment, capture_output=True, check=False, timeout=250)
    assert not (folder_with_traps / "ran").exists()
