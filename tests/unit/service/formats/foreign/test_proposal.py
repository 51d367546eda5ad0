"""A proposal asks for zone, unit and order of day and month, and never answers them by itself."""

from datetime import UTC, datetime

import pytest
from foreign_files import Writing, table, truth
from hypothesis import given
from hypothesis import strategies as st

from service.formats.foreign.clock import formats_of
from service.formats.foreign.fault import ForeignTableError
from service.formats.foreign.layout import StatedLayout
from service.formats.foreign.proposal import Sample, propose

CARRIERS = ("c00", "c01")
AS_USUAL, NOTHING = Writing(), StatedLayout()
PLAN = {"c00": "c00", "c01": "c01", "Rostov": "c01"}


def sample(writing: Writing = AS_USUAL, rows: int = 30, day: int = 21) -> Sample:
    """Return a sample of a table."""
    header, *lines = table(truth(CARRIERS, rows, datetime(2026, 3, day, tzinfo=UTC)), writing)
    return Sample(header, lines)


def asked(found: Sample, stated: StatedLayout = NOTHING) -> dict[str, tuple[str, ...]]:
    """Return the choices of the questions by option."""
    return {each.option: each.choices for each in propose(found, stated, PLAN).questions}


def test_zone_and_unit_are_asked_for() -> None:
    assert asked(sample()) == {"--tz": (), "--unit": ("dBm", "dBW")}
    assert asked(sample(), StatedLayout(tz="UTC")) == {"--unit": ("dBm", "dBW")}
    assert asked(sample(), StatedLayout(tz="UTC", unit="dBW")) == {}


@given(st.integers(1, 12), st.integers(1, 12))
def test_an_order_of_day_and_month_that_is_not_proven_is_asked_for(day: int, month: int) -> None:
    texts = [datetime(2026, month, day, hour, tzinfo=UTC).strftime("%d.%m.%Y %H:%M:%S") for hour in range(24)]
    assert set(formats_of(texts)) == {"%d.%m.%Y %H:%M:%S", "%m.%d.%Y %H:%M:%S"}


@given(st.integers(13, 28), st.integers(1, 12), st.sampled_from(["%d.%m.%Y %H:%M", "%m/%d/%Y %H:%M"]))
def test_one_day_above_the_twelfth_proves_the_order(day: int, month: int, pattern: str) -> None:
    days = [datetime(2026, month, each, 10, tzinfo=UTC) for each in (*range(2, 13), day)]
    assert formats_of([each.strftime(pattern) for each in days]) == [pattern]


def test_an_ambiguous_order_stays_a_question_of_the_table() -> None:
    found = sample(Writing(pattern="%d.%m.%Y %H:%M:%S"), day=2)
    assert set(asked(found)["--time-format"]) == {"%d.%m.%Y %H:%M:%S", "%m.%d.%Y %H:%M:%S"}
    assert "--time-format" not in asked(found, StatedLayout(time_format="%d.%m.%Y %H:%M:%S"))


@pytest.mark.parametrize(("level", "default"), [(-200.0, "dBW"), (-75.0, None), (10.0, "dBm")])
def test_a_unit_is_suggested_only_where_the_other_is_impossible(level: float, default: str | None) -> None:
    rows = [[f"2026-03-21 00:{k:02}:00", str(level + k / 100)] for k in range(20)]
    (question,) = propose(Sample(["t", "c00"], rows), StatedLayout(tz="UTC"), PLAN).questions
    assert (question.option, question.default) == ("--unit", default)


def test_columns_are_matched_by_id_and_name_and_never_by_likeness() -> None:
    rows = [[f"2026-03-21 00:{k:02}:00", "-60.5", "-61.5", "-62.5"] for k in range(20)]
    found = propose(Sample(["t", "C00 [dBm]", "rostov (dBW)", "c0"], rows), StatedLayout(tz="UTC"), PLAN)
    assert found.layout is not None
    assert dict(found.layout.carriers) == {"C00 [dBm]": "c00", "rostov (dBW)": "c01"}
    assert dict(found.layout.units) == {"C00 [dBm]": "dBm", "rostov (dBW)": "dBW"}
    assert asked(Sample(["t", "power 1", "power 2", "x"], rows), StatedLayout(tz="UTC")) == {
        "--map": ("power 1", "power 2", "x")
    }


@pytest.mark.parametrize(
    ("header", "stated", "message"),
    [
        (["t", "c00", "c00"], StatedLayout(), "occur twice: c00"),
        (["t", "c00", "C00"], StatedLayout(), "several columns are carrier c00"),
        (["t", "c01", "Rostov"], StatedLayout(), "several columns are carrier c01"),
        (["t", "c00", "x"], StatedLayout(carriers={"x": "c77"}), "no carrier of the plan"),
        (["t", "c00", "x"], StatedLayout(carriers={"y": "c01"}), "no column 'y'"),
        (["t", "c00 dBm", "x"], StatedLayout(unit="dBW"), "states dBm, --unit states dBW"),
        (["t", "c00", "x"], StatedLayout(time_columns=("time",)), "no column 'time'"),
        (["t", "c00", "x"], StatedLayout(tz="Mars/Olympus"), "no time zone"),
        (["t", "c00", "x"], StatedLayout(time_format="%d.%m.%Y"), "does not read the epochs"),
        (["t", "c00", "x"], StatedLayout(time_format="ddmmyy"), "--time-format 'ddmmyy' is unknown"),
    ],
)
def test_what_the_table_contradicts_is_refused(header: list[str], stated: StatedLayout, message: str) -> None:
    rows = [[f"2026-03-21 00:{k:02}:00", "-60.5", "-61.5"] for k in range(20)]
    with pytest.raises(ForeignTableError, match=message):
        propose(Sample(header, rows), stated, PLAN)


def test_decimals_of_two_kinds_are_refused() -> None:
    rows = [[f"2026-03-21 00:{k:02}:00", "-60.5", "-61,5"] for k in range(20)]
    with pytest.raises(ForeignTableError, match="decimals of two kinds"):
        propose(Sample(["t", "c00", "c01"], rows), StatedLayout(), PLAN)
