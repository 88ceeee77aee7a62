"""The import of torch, which only training needs: beside other work, and one line where it is missing.

Nothing that views, edits or converts imports torch; `pip install splatview` comes without it.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib.util
import sys
import threading
from pathlib import Path

from splatview.scene import InputError

MISSING = "training needs PyTorch, which is not installed: pip install 'splatview[train]'"


def has_torch() -> bool:
    """Whether torch is installed; it is not imported."""
    if "torch" in sys.modules:
        return sys.modules["torch"] is not None
    return importlib.util.find_spec("torch") is not None


def require_torch() -> None:
    """Raises InputError where torch is not installed."""
    if not has_torch():
        raise InputError(MISSING)


class TorchImport:
    """The import of torch: its libraries mapped in a thread, beside other work, its modules on waiting.

    Modules take turns with whatever Python does beside them: imported in the thread as well, they made a
    start slower, 3.1 s to the first step, against 2.7 s with all of it on waiting and 2.4 s as it is (medians
    of 8 in turn, 2 cores). torch's own threads are switched off: between two operations they wait in loops on
    the cores that the kernels work on, and what they would add up depends on their number.
    """

    def __init__(self) -> None:
        """Raises InputError where torch is not installed."""
        require_torch()
        # Modules are never garbage: looking for it among their objects took a sixth of the start.
        self._collects = gc.isenabled()
        gc.disable()
        self._thread = threading.Thread(target=_map_libraries, name="splatview-torch", daemon=True)
        self._thread.start()

    def wait(self) -> None:
        """Returns when torch can be used. Raises InputError where it cannot."""
        self._thread.join()
        try:
            import torch

            torch.set_num_threads(1)
        except (ImportError, OSError, RuntimeError) as error:
            reason = " ".join(str(error).split())
            raise InputError(
                f"PyTorch cannot be imported ({reason}); install it anew: pip install 'splatview[train]'"
            ) from None
        finally:
            if self._collects:
                gc.freeze()  # nor do later collections look at what has been imported
                gc.enable()
                self._collects = False


def _map_libraries() -> None:
    """Maps the largest library, for which Python need not stand still; where that fails, the import says."""
    spec = importlib.util.find_spec("torch") if "torch" not in sys.modules else None
    for folder in (spec and spec.submodule_search_locations) or ():
        for library in Path(folder, "lib").glob("libtorch_cpu.*"):
            with contextlib.suppress(OSError):
                ctypes.CDLL(str(library))
