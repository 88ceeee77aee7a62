"""Stops `make` with one clear line where Python is too old; runs on any Python 3."""

import sys

OLDEST = (3, 11)

if sys.version_info < OLDEST:
    sys.exit(
        "splatview needs Python {}.{} or newer, this is {}.{}: run make PYTHON=/path/to/newer/python3".format(
            *OLDEST, *sys.version_info[:2]
        )
    )
try:
    import ensurepip  # noqa: F401
    import venv  # noqa: F401
except ImportError:
    sys.exit("Python's venv module is missing: on Debian or Ubuntu, apt-get install python3-venv")
