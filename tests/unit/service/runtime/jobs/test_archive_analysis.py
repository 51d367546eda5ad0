"""Advice and methods that run, from what the archive holds."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from synthetic_payload import HOUR, START_US, SyntheticPayload

from service.records.catalogue import Method
from service.records.levels.attitude import row_without_attitude
from service.runtime.jobs.archive_analysis import newest_advice, runnable_methods

PAYLOAD = SyntheticPayload.make(6)


def storage_with(**results: Any) -> Any:
    """Return a storage whose results answer as stated."""
    return SimpleNamespace(results=SimpleNamespace(**{name: lambda *_, v=value: v for name, value in results.items()}))


@pytest.mark.parametrize("advice", [(), ("realign",), ("realign", "state_torque")])
def test_the_newest_row_of_the_filter_advises(advice: tuple[str, ...]) -> None:
    row = replace(row_without_attitude(START_US, START_US, 1, Method.ROBUST, ()), advice=advice)
    assert newest_advice(storage_with(newest_attitude=row), "sc") == advice


def test_without_a_row_nothing_is_advised() -> None:
    assert newest_advice(storage_with(newest_attitude=None), "sc") == ()


@pytest.mark.parametrize(
    ("named", "methods"),
    [
        ({"robust": 3, "paper": 3}, {Method.ROBUST, Method.PAPER}),
        ({"robust": 3}, {Method.ROBUST}),
        ({"paper": 3}, {Method.PAPER}),
        ({}, {Method.PAPER}),
    ],
)
def test_methods_that_the_alignment_started_run(named: dict[str, int], methods: set[Method]) -> None:
    alignment = replace(PAYLOAD.alignment(START_US + HOUR), calibration_by_method=named)
    assert set(runnable_methods(storage_with(alignments=(alignment,)), "sc")) == methods


def test_without_an_alignment_nothing_runs() -> None:
    assert runnable_methods(storage_with(alignments=()), "sc") == ()
