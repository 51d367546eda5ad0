"""Rows and samples as arrays: names, units, absent values, and the sense of the rotations."""

import importlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.client.series_table import SeriesArrays, table_of_rows, table_of_samples
from service.core.geometry.frames import body_from_nadir
from service.core.geometry.quaternion import quaternion_of_attitude

EPOCHS = ["2026-11-21T03:00:00.000000Z", "2026-11-21T03:01:00.500000Z"]
AXES = ("yaw_deg", "roll_deg", "pitch_deg")


def row(epoch: str, yaw_deg: float | None = 0.3, **others: Any) -> dict[str, Any]:
    """Return an attitude row as the contract has it."""
    angles = {"yaw_deg": yaw_deg, "roll_deg": -0.2, "pitch_deg": 0.1}
    sigma = {"sigma_deg": {"yaw": 0.1, "roll": 0.01, "pitch": None}, "rates_deg_s": None}
    words = {"method": "robust", "version": "live", "status": "ACQUIRED", "received_at": epoch}
    return {"epoch": epoch, **angles, **sigma, **words, "carriers_used": 12, "downlink_fade": False, **others}


def test_numbers_become_columns_with_units_and_shared_words_attributes() -> None:
    table = table_of_rows([row(EPOCHS[0]), row(EPOCHS[1], None, status="INVALID")])
    assert table.epochs.tolist()[1].isoformat() == "2026-11-21T03:01:00.500000"
    np.testing.assert_array_equal(table.columns["yaw_deg"], [0.3, np.nan])
    np.testing.assert_array_equal(table.columns["roll_sigma_deg"], [0.01, 0.01])
    assert table.columns.keys() == {*AXES, "yaw_sigma_deg", "roll_sigma_deg", "carriers_used"}
    assert table.units == dict.fromkeys([*AXES, "yaw_sigma_deg", "roll_sigma_deg"], "deg")
    assert table.attributes == {"method": "robust", "version": "live"}


def test_rows_without_a_value_can_be_left_out() -> None:
    table = table_of_rows([row(EPOCHS[0], None), row(EPOCHS[1])]).complete(*AXES)
    assert table.columns["yaw_deg"].tolist() == [0.3]
    assert len(table.epochs_us) == len(table.columns["carriers_used"]) == 1
    assert len(table.rotations()) == 1


def test_no_rows_give_no_columns() -> None:
    table = table_of_rows([])
    assert (len(table.epochs), table.columns, table.units) == (0, {}, {})


def test_samples_are_named_by_method_or_carrier() -> None:
    series = [
        {"quantity": "roll_deg", "method": "paper", "carrier": None, "avg": [1.0, None], "min": [0.5, None]},
        {"quantity": "power_dbm", "method": None, "carrier": "c00", "avg": [-42.0, -43.0], "min": [-44.0, -45.0]},
    ]
    samples = {"series": series, "epochs": EPOCHS, "interval_s": 60, "version": "live"}
    table = table_of_samples(samples, "min")
    np.testing.assert_array_equal(table.columns["paper_roll_deg"], [0.5, np.nan])
    assert table.units == {"paper_roll_deg": "deg", "c00_power_dbm": "dBm"}
    assert table.attributes == {"statistic": "min", "version": "live", "interval_s": "60"}


@given(st.lists(st.tuples(*[st.floats(-89.0, 89.0)] * 3), min_size=1, max_size=5))
def test_rotations_are_those_of_the_frames(attitude_deg: list[tuple[float, float, float]]) -> None:
    angles = np.array(attitude_deg)
    columns = dict(zip(AXES, angles.T, strict=True))
    rotations = SeriesArrays(np.arange(len(angles)), columns).rotations()
    np.testing.assert_allclose(rotations.inv().as_matrix(), body_from_nadir(angles), atol=1e-14)
    # messages name the frame rotation nadir -> body, which is the turn of the body itself
    alignment = np.abs(np.sum(rotations.as_quat() * quaternion_of_attitude(angles), axis=-1))
    np.testing.assert_allclose(alignment, 1.0, atol=1e-14)


def test_a_row_without_an_attitude_is_no_rotation() -> None:
    table = table_of_rows([row(EPOCHS[0]), row(EPOCHS[1], None)])
    with pytest.raises(ValueError, match=r"1 rows have no attitude, the first at 2026-11-21T03:01:00\.500000Z; call"):
        table.rotations()


def test_pandas_and_xarray_keep_instants_units_and_attributes() -> None:
    table = table_of_rows([row(EPOCHS[0]), row(EPOCHS[1], None)])
    frame = table.to_pandas()
    assert [instant.isoformat() for instant in frame.index][1] == "2026-11-21T03:01:00.500000+00:00"
    assert (frame.attrs["units"]["yaw_deg"], frame.attrs["method"]) == ("deg", "robust")
    data = table.to_xarray()
    assert (data["yaw_deg"].attrs, data["carriers_used"].attrs) == ({"units": "deg"}, {})
    assert (data.attrs["version"], data["epoch"].attrs["time_system"]) == ("live", "UTC")
    np.testing.assert_array_equal(data["epoch"].values.astype("datetime64[us]"), table.epochs)
    np.testing.assert_array_equal(frame["yaw_deg"].to_numpy(), data["yaw_deg"].values)


def test_a_missing_package_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str, *others: Any) -> Any:
        raise ModuleNotFoundError(name=name)

    table = table_of_rows([row(EPOCHS[0])])
    monkeypatch.setattr(importlib, "import_module", missing)
    for convert in (table.to_pandas, table.to_xarray):
        with pytest.raises(ModuleNotFoundError, match=r"is not installed; pip install soo\[analysis\]"):
            convert()
