"""Compiled functions: numba's compiler, and machine code that later processes find again.

Imported where something is about to be compiled only: the import of numba takes a quarter of a second.
"""

import contextlib
from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache


class _KeptCode(FunctionCache):
    """Machine code of one function on the disk; what cannot be read is forgotten, what cannot be written is not kept.

    numba itself fails at each call where a file was cut or the disk is full.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the machine code for some types of arguments, None where there is none that can be read."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # noqa: BLE001 damaged bytes raise anything; to compile again is right after every error
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write machine code."""
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)


def compiled(function: Callable[..., Any]) -> Any:
    """Return a function of numbers and arrays that is compiled at its first call, or read from what was kept before.

    Machine code is kept beside the source or in the user's cache; where neither can be written, and where what is there
    cannot be read, it is compiled.
    """
    dispatcher: Any = njit(nogil=True, error_model="numpy")(function)
    with contextlib.suppress(RuntimeError):  # no place
        dispatcher._cache = _KeptCode(function)  # noqa: SLF001 numba has no name for a cache of another kind
    return dispatcher
