"""Claims about the choice of kernels."""

import numpy as np
import pytest

from service.core.estimation.filtering.rows.row_kernels import ARRAYS, compiled_kernels
from service.pipeline import kernels as filter_kernels
from service.pipeline.kernels import kernels_named


@pytest.fixture(autouse=True)
def _forgotten_choice():
    """Ask again in every test."""
    kernels_named.cache_clear()
    yield
    kernels_named.cache_clear()


def test_numpy_compiles_nothing():
    assert kernels_named("numpy") is ARRAYS


def test_numba_is_compiled_once():
    assert kernels_named("numba") is kernels_named("numba") is compiled_kernels()


def test_without_a_place_for_machine_code_it_is_compiled_all_the_same(monkeypatch):
    def homeless(*, is_cached: bool = True):
        if is_cached:
            raise RuntimeError("cannot cache function: no locator available")
        return compiled_kernels(is_cached=False)

    monkeypatch.setattr(filter_kernels, "compiled_kernels", homeless)
    kernels = kernels_named("numba")
    assert kernels is compiled_kernels(is_cached=False)
    level_deg = kernels.anchor.levels(np.ones(1), np.zeros((1, 3)), np.full((1, 3), 0.1), 1e-4)
    np.testing.assert_allclose(level_deg, 0.389, atol=1e-3)  # 3.89 sigma of a normal error
