"""Machine code is kept between processes; where it cannot be read or written, functions are compiled and go on."""

import importlib
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import filter_models
import numpy as np
import pytest
from filter_rows import step
from numba.core import caching
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import cpu_target

from service.core.compiled_entry import CompiledEntry
from service.core.estimation.filtering.filter_model import no_motion
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.plant import filter_model
from service.core.machine_code import compiled, compiled_with, whole_code

CALLED = "FACTOR = {factor}\n\ndef scaled(values):\n    return FACTOR * values\n"
ENTRY = "from called_arithmetic import scaled\n\ndef run(values):\n    return scaled(values) + 1.0\n"
MODULES = ("called_arithmetic", "entry_arithmetic")
TWO = np.ones(2)


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    """Function that compiles one of two modules as every process does, and returns it after a call."""
    monkeypatch.setattr(caching.config, "CACHE_DIR", str(tmp_path / "kept"))
    # the modules are read from their sources each time
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "entry_arithmetic.py").write_text(ENTRY)

    def fresh(factor=2.0):
        (tmp_path / "called_arithmetic.py").write_text(CALLED.format(factor=factor))
        for name in MODULES:
            monkeypatch.delitem(sys.modules, name, raising=False)
        importlib.invalidate_caches()
        modules = [importlib.import_module(name) for name in MODULES]
        function = compiled_with(modules[1].run, modules)
        np.testing.assert_array_equal(function(TWO), factor * TWO + 1.0)
        return function

    yield fresh
    for name in MODULES:
        sys.modules.pop(name, None)


def hits(function):
    """Return how often machine code was read."""
    return sum(function.stats.cache_hits.values())


def kept(tmp_path, pattern):
    """Return the one file of a kind that numba keeps."""
    (path,) = (tmp_path / "kept").rglob(pattern)
    return path


def test_machine_code_is_read_by_the_next_process(fresh):
    assert [hits(fresh()), hits(fresh())] == [0, 1]


def test_machine_code_of_an_older_source_of_a_called_function_is_not_used(fresh):
    assert [hits(fresh(2.0)), hits(fresh(3.0)), hits(fresh(3.0)), hits(fresh(2.0))] == [0, 0, 1, 0]


@pytest.mark.parametrize("pattern", ["*.nbi", "*.nbc"])
@pytest.mark.parametrize("size", [0, 1, 40, -1])
def test_a_file_that_was_cut_is_compiled_again_and_kept(fresh, tmp_path, pattern, size):
    fresh()
    path = kept(tmp_path, pattern)
    path.write_bytes(path.read_bytes()[:size])
    assert [hits(fresh()), hits(fresh())] == [0, 1]


@pytest.mark.parametrize("pattern", ["*.nbi", "*.nbc"])
def test_a_file_of_other_bytes_is_compiled_again(fresh, tmp_path, pattern):
    fresh()
    kept(tmp_path, pattern).write_bytes(b"no machine code")
    assert [hits(fresh()), hits(fresh())] == [0, 1]


def test_what_cannot_be_kept_is_compiled_by_every_process(fresh, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(caching.IndexDataCacheFile, "save", full)
    assert [hits(fresh()), hits(fresh())] == [0, 0]


def test_without_a_place_it_is_compiled(fresh, monkeypatch):
    monkeypatch.setattr(caching.CompileResultCacheImpl, "_locator_classes", [])
    assert [hits(fresh()), hits(fresh())] == [0, 0]


def test_other_forms_of_arrays_are_brought_into_the_one_that_is_compiled(fresh):
    fresh()
    modules = [sys.modules[name] for name in MODULES]
    entry = CompiledEntry(modules[1].run, modules)
    plain, read_only = np.arange(6.0), np.arange(6.0)
    read_only.setflags(write=False)
    # the first one decides about nothing
    for values in (read_only, plain, np.arange(12.0)[::2] / 2.0, read_only):
        np.testing.assert_array_equal(entry(values), 2.0 * np.arange(6.0) + 1.0)
    with pytest.raises(TypeError):
        entry(np.arange(6))
    assert len(entry._compiled.signatures) == 1


def test_entries_that_threads_compile_at_once_are_right_and_leave_the_compiler_as_it_was(fresh):
    fresh()
    modules = [sys.modules[name] for name in MODULES]
    codegen = cpu_target.target_context.codegen()
    entries = [CompiledEntry(modules[1].run, modules) for _ in range(4)]
    with ThreadPoolExecutor(4) as pool:
        for answer in pool.map(lambda entry: entry(np.arange(3.0)), entries):
            np.testing.assert_array_equal(answer, 2.0 * np.arange(3.0) + 1.0)
    assert codegen._library_class is JITCodeLibrary
    assert "set_env" not in vars(codegen)
    # what is compiled on another road afterwards finds the inner functions as they should be
    assert compiled(lambda values: values.sum() + 1.0)(TWO) == 3.0


def test_code_optimised_as_a_whole_is_read_by_the_next_process(fresh):
    with whole_code():
        first = fresh()
    assert [hits(first), hits(fresh())] == [0, 1]


def filtered():
    """Return mean and sigma of the filter after some rows, of which one carrier steps in the last."""
    model, rng = filter_models.carrier_model(), np.random.default_rng(3)
    arrays, state = filter_model(model), start(model, 0, filter_models.aligned(model))
    for row in range(1, 16):
        deviation_db = rng.normal(0.0, 0.15, model.carriers) + 3.0 * (row > 12) * (np.arange(model.carriers) == 2)
        found = step(arrays, state, row * filter_models.MINUTE_US, deviation_db, no_motion())
        state = found.state
    return [*state.mean.tolist(), *np.sqrt(state.covariance.diagonal()).tolist(), *found.row["protection_deg"].tolist()]


def test_without_the_compiler_the_filter_runs_as_it_stands():
    asked = "import json, test_machine_code as here; print(json.dumps(here.filtered()))"
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": path}
    command = [sys.executable, "-c", asked]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=True)
    np.testing.assert_allclose(json.loads(done.stdout), filtered(), rtol=1e-9, atol=1e-12)
