"""Compiled functions: numba's compiler, and machine code that later processes find again.

Imported where something is about to be compiled only: the import of numba takes a quarter of a second.
"""

import contextlib
import hashlib
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from types import FunctionType, ModuleType
from typing import Any

import scipy
from llvmlite import binding
from numba import config, njit
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import cpu_target
from numba.core.runtime.nrt import rtsys
from numba.extending import register_jitable

#: nothing but compiled functions calls the functions of a module
_INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
#: functions that compiled ones may call
_CALLED: set[FunctionType] = set()
#: what machine code imports at its first product of matrices
_BLAS = "scipy.linalg.cython_blas"


class _KeptParts(CompileResultCacheImpl):
    """Parts of a compiled function that are kept: of an entry no environments of what it calls.

    Nothing but calls from Python and printing reads them, and to make them again imports half of numba and scipy.
    """

    def reduce(self, data: Any) -> Any:
        """Return what is kept of a result of the compiler."""
        *parts, environments = super().reduce(data)
        return (*parts, () if isinstance(data.library, _WholeCode) else environments)


class _KeptCode(FunctionCache):
    """Machine code of one function on the disk; what cannot be read is forgotten, what cannot be written is not kept.

    numba itself fails at each call where a file was cut or the disk is full, and asks only the file of the function
    whether its machine code is old; a stamp of all sources takes the place of that.
    """

    _impl_class = _KeptParts

    def __init__(self, function: Callable[..., Any], stamp: str | None) -> None:
        super().__init__(function)
        if stamp is not None:
            self._cache_file = IndexDataCacheFile(self._cache_path, self._impl.filename_base, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the machine code for some types of arguments, None where there is none that can be read."""
        try:
            # numba itself imports all that it can compile, 0.2 s; machine code needs the functions of memory alone
            rtsys.initialize(target_context)
            return self._load_overload(sig, target_context)
        except Exception:  # noqa: BLE001 damaged bytes raise anything; to compile again is right after every error
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write machine code."""
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)


class _WholeCode(JITCodeLibrary):
    """Code of a function and of all that it calls, optimised once, not again at each function on the way up.

    Half of the compiler's time. Machine code is made where it is asked for: of the entry, never of what it calls.
    """

    _is_linked_only = False

    def finalize(self) -> None:
        """Link what the function calls, as it stands."""
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)  # noqa: SLF001
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)  # noqa: SLF001
        self._finalize_dynamic_globals()
        self._is_linked_only = self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return the address of a function, 0 where the library has none of the name."""
        self._ensure_finalized()
        if self._is_linked_only and name not in {each.name for each in self.get_defined_functions()}:
            return 0
        self._complete()
        return int(super().get_pointer_to_function(name))

    def serialize_using_object_code(self) -> Any:
        """Return name and machine code, and in place of the code that others could link the names that it defines.

        Nothing is linked with an entry, and to read that code took ten times as long as the machine code.
        """
        self._ensure_finalized()
        self._complete()
        defined = "\n".join(f'define void @"{each.name}"() {{ ret void }}' for each in self.get_defined_functions())
        return self.name, "object", (self._get_compiled_object(), binding.parse_assembly(defined).as_bitcode())

    def _complete(self) -> None:
        """Optimise what is linked, and hand it to the machine."""
        if self._is_linked_only:
            self._is_linked_only = self._finalized = False
            self._optimize_final_module()
            self._final_module.verify()
            self._finalize_final_module()


@contextlib.contextmanager
def whole_code() -> Iterator[None]:
    """Let entries that are compiled meanwhile be optimised as a whole."""
    codegen = cpu_target.target_context.codegen()
    # what is only linked has no place yet where its environment could stand
    codegen.set_env = lambda name, env: _set_env(codegen, name, env)
    codegen._library_class = _WholeCode  # noqa: SLF001 numba has no name for it
    try:
        yield
    finally:
        with contextlib.suppress(AttributeError):  # another thread that compiled has done it
            del codegen.set_env, codegen._library_class  # noqa: SLF001


def _set_env(codegen: Any, name: str, env: Any) -> None:
    if codegen._engine.get_global_value_address(name):  # noqa: SLF001
        type(codegen).set_env(codegen, name, env)


def compiled(function: Callable[..., Any], stamp: str | None = None) -> Any:
    """Return a function of numbers and arrays that is compiled at its first call, or read from what was kept before.

    Machine code is kept beside the source or in the user's cache; where neither can be written, and where what is there
    cannot be read, it is compiled. `stamp` tells whether it is old, without one the file of the function does.
    """
    dispatcher: Any = njit(nogil=True, error_model="numpy")(function)
    with contextlib.suppress(RuntimeError):  # no place
        dispatcher._cache = _KeptCode(function, stamp)  # noqa: SLF001 numba has no name for a cache of another kind
    return dispatcher


def compiled_with(run: Callable[..., Any], modules: Sequence[ModuleType]) -> Any:
    """Return a function that is compiled with the functions and constants of its own and other modules.

    Machine code is old where one of the modules has changed. With ``NUMBA_DISABLE_JIT=1`` it is the function itself.
    """
    if config.DISABLE_JIT:  # type: ignore[attr-defined]  # named at the start only
        return run
    for module in modules:
        for part in vars(module).values():
            if isinstance(part, FunctionType) and part.__module__ == module.__name__ and part not in _CALLED:
                _CALLED.add(part)
                register_jitable(**_INNER)(part)
    _load_blas()
    # the loader of a module has its source wherever it was installed
    sources = (vars(module)["__loader__"].get_source(module.__name__) for module in modules)
    return compiled(run, hashlib.sha256("".join(map(str, sources)).encode()).hexdigest())


def _load_blas() -> None:
    """Load what products of matrices call, without its package, of which they use nothing: 0.1 s and 25 MB.

    Where scipy has it elsewhere, the first product imports it with the package.
    """
    if _BLAS in sys.modules:
        return
    spec = PathFinder.find_spec(_BLAS, [f"{folder}/linalg" for folder in scipy.__path__])
    if spec is not None and spec.loader is not None:
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
        sys.modules.setdefault(_BLAS, module)
