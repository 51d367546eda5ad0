"""A worker of a cluster computes only where its programs are those of the caller."""

import pytest

from service.study import executors
from service.study.executors import ClusterError


@pytest.mark.parametrize("name", ["soo", "numba", "python"])
def test_a_worker_of_another_version_is_refused_by_name(monkeypatch, name):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    here = executors._programs()
    assert executors._run_checked(here, lambda: 7) == 7
    refused = rf"{name} {here[name]} in place of 0\.0: bring it to the state of this machine"
    with pytest.raises(ClusterError, match=refused):
        executors._run_checked(here | {name: "0.0"}, lambda: 7)
