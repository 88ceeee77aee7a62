"""The same loaders, with files that are led by which branches of the reader they reach (needs atheris).

    python tools/fuzz/fuzz_guided.py LOADER FOLDER [flags of libFuzzer, -max_total_time=60 say]

FOLDER collects files that reach something new, beside the whole ones and those of the corpus; -merge=1 with
two folders boils such a collection down (see libFuzzer's documentation). A failure ends the run, with its
file as crash-* in the current folder. No part of splatview needs atheris: `pip install atheris`.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
from pathlib import Path

try:
    import atheris  # pyright: ignore[reportMissingImports]
except ImportError:
    atheris = None

instrumented = contextlib.nullcontext()
if atheris is not None:
    instrumented = atheris.instrument_imports(  # pyright: ignore[reportAttributeAccessIssue]
        include=[
            "splatview.scene",
            "splatview.edit",
            "splatview.trainer.checkpoint",
            "splatview.viewer.open",
            "splatview.viewer.preferences",
        ],
        exclude=["splatview.edit.kernels", "splatview.scene.demo"],
    )
with instrumented:
    from loaders import BY_NAME
    from trials import Trial, limit_memory


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("loader", choices=BY_NAME)
    parser.add_argument("folder", type=Path)
    options, flags = parser.parse_known_args()
    if atheris is None:
        parser.error("atheris is not installed")
    loader, folder = BY_NAME[options.loader], options.folder
    folder.mkdir(parents=True, exist_ok=True)
    for number, data in enumerate(loader.corpus()):
        (folder / f"whole-{number:03d}").write_bytes(data)
    limit_memory()
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as name:
        trial = Trial(loader, Path(name))
        for data in loader.corpus():
            trial(data)

        def one(data: bytes) -> None:
            result = trial(data)
            if result.outcome == "failed":
                raise AssertionError(result.what)

        words = folder.with_suffix(".words")
        words.write_text("".join(f'"{_quoted(word)}"\n' for word in loader.words))
        flags = [str(folder), *flags, *([f"-dict={words}"] if loader.words else [])]
        atheris.Setup([sys.argv[0], *flags], one)
        atheris.Fuzz()


def _quoted(word: bytes) -> str:
    return "".join(f"\\x{byte:02x}" for byte in word)


if __name__ == "__main__":
    main()
