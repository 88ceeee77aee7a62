"""The import of torch, which only training needs: beside other work, and one line where it is missing.

Nothing that views, edits or converts imports torch; `pip install splatview` comes without it.
"""

from __future__ import annotations

import gc
import importlib.util
import sys
import threading

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
    """The import of torch in a thread, begun at once: 1.5 to 2 s of a core that photos do not wait for.

    torch's own threads are switched off with it: between two operations they wait in loops on the cores that
    the kernels work on, and what they would add up depends on their number.
    """

    def __init__(self) -> None:
        """Raises InputError where torch is not installed."""
        require_torch()
        self._error: Exception | None = None
        # Modules are never garbage: looking for it among their objects took a sixth of the start.
        self._collects = gc.isenabled()
        gc.disable()
        self._thread = threading.Thread(target=self._work, name="splatview-torch", daemon=True)
        self._thread.start()

    def wait(self) -> None:
        """Returns when torch can be used. Raises InputError where it cannot."""
        self._thread.join()
        if self._collects:
            gc.freeze()  # nor do later collections look at what has been imported
            gc.enable()
            self._collects = False
        if self._error is not None:
            reason = " ".join(str(self._error).split())
            raise InputError(
                f"PyTorch cannot be imported ({reason}); install it anew: pip install 'splatview[train]'"
            )

    def _work(self) -> None:
        try:
            import torch

            torch.set_num_threads(1)
        except (ImportError, OSError, RuntimeError) as error:
            self._error = error
