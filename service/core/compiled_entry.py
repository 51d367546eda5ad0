"""Entry of compiled functions: one form of arguments, compiled at the first call."""

import gc
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

import numpy as np

#: thresholds of the collector while something is compiled
_FEWER_COLLECTIONS = (20_000, 50, 10)


class CompiledEntry:
    """A function of a few arrays, compiled at its first call with the functions of its own and other modules.

    One form of arguments is compiled; others are brought into it: arrays that were restored or cut out of others are
    other types to the compiler, and each would be compiled again.

    Parameters
    ----------
    run : callable
        Function of one of the modules.
    modules : sequence of modules
        Whose functions and constants are compiled.
    """

    def __init__(self, run: Callable[..., Any], modules: Sequence[ModuleType]) -> None:
        self._run, self._modules = run, modules
        self._compiled: Any = None

    def __call__(self, *args: Any) -> Any:
        """Return what the function makes of the arguments."""
        if self._compiled is None:
            return self._first(*args)
        try:
            return self._compiled(*args)
        except TypeError:
            return self._compiled(*_plain(args))

    def _first(self, *args: Any) -> Any:
        # the import costs a quarter of a second: only a program that computes rows pays it
        from service.core.machine_code import compiled_with, whole_code

        compiled, limits = compiled_with(self._run, self._modules), gc.get_threshold()
        # a sixth of the compiler's time: the collector goes over what it builds again and again
        gc.set_threshold(*_FEWER_COLLECTIONS)
        try:
            with whole_code():
                result = compiled(*_plain(args))
        finally:
            gc.set_threshold(*limits)
        if compiled is not self._run:
            compiled.disable_compile()
        self._compiled = compiled
        return result


def _plain(value: Any) -> Any:
    """Return arguments whose arrays can be written and stand in one piece of memory."""
    if isinstance(value, np.ndarray):
        return np.require(value, requirements=["C", "W"])
    if isinstance(value, tuple):
        parts = [_plain(each) for each in value]
        return type(value)(*parts) if hasattr(value, "_fields") else type(value)(parts)
    return value
