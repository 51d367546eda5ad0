"""Machine code is kept between processes; where it cannot be read or written, functions are compiled and go on."""

import importlib.util

import numpy as np
import pytest
from numba.core import caching

from service.core.machine_code import compiled

SOURCE = "def doubled(values):\n    return values + values\n"
TWO = np.ones(2)


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    """Function that compiles one and the same function as every process does, and returns it after a call."""
    monkeypatch.setattr(caching.config, "CACHE_DIR", str(tmp_path / "kept"))
    source = tmp_path / "arithmetic.py"
    source.write_text(SOURCE)

    def fresh():
        spec = importlib.util.spec_from_file_location("arithmetic", source)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        function = compiled(module.doubled)
        np.testing.assert_array_equal(function(TWO), 2 * TWO)
        return function

    return fresh


def hits(function):
    """Return how often machine code was read."""
    return sum(function.stats.cache_hits.values())


def kept(tmp_path, pattern):
    """Return the one file of a kind that numba keeps."""
    (path,) = (tmp_path / "kept").rglob(pattern)
    return path


def test_machine_code_is_read_by_the_next_process(fresh):
    assert [hits(fresh()), hits(fresh())] == [0, 1]


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
