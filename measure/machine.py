"""The machine that a figure was measured on, and benchmark results as JSON that names it."""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

FOLDER = Path("assets") / "benchmarks"
"""Where committed benchmark results lie, in the repository."""


def describe_machine() -> dict[str, Any]:
    """Processor, cores open to this process, operating system, Python: no figure means much without."""
    processor = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass  # not Linux: the platform's own word has to do
    return {
        "processor": processor,
        "cores": available_cores(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
    }


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def finite(value: Any) -> Any:
    """A number, or numbers in a list, as JSON can hold them: None for NaN and infinities."""
    if isinstance(value, list):
        return [finite(part) for part in value]
    return value if math.isfinite(value) else None


def write_results(path: Path, results: Mapping[str, Any]) -> None:
    """Writes one benchmark's JSON, the machine's description added under ``machine``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"machine": describe_machine(), **results}, indent=1, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf8")
