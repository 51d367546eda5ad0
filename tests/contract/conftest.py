"""Storages under test and makers of records; every storage has to keep the same contract."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import stored_records

from db.storage import SqlStorage
from service.ports.archive import ListPart, Outcome
from service.ports.storage import Storage
from service.records.calibration import (
    Alignment,
    Calibration,
    CalibrationMethod,
    CalibrationRequest,
    CalibrationResult,
    Observability,
    Window,
)
from service.records.catalogue import Carrier, Ephemeris, Method, Site, Spacecraft
from service.records.levels.attitude import NO_ANGLES, AttitudeRow, Axes
from service.records.levels.measurement import BatchReceipt, CarrierDetails, Measurement, MeasurementBatch

CARRIERS = tuple(Carrier(f"c{k:02}", "C", f"t{k // 2}", 3.7e9 + k * 1e7, 5e6) for k in range(3))
INERTIA = ((4000.0, 0.0, 0.0), (0.0, 2000.0, 0.0), (0.0, 0.0, 4000.0))
EVER = Window(0, 1 << 60)

_names = count()


@dataclass
class Setting:
    """A storage with a spacecraft that has a carrier plan, and short words for what tests do often."""

    storage: Storage
    id: str
    plan_id: int

    def batch(
        self,
        epochs_us: Sequence[int],
        power_dbm: object = -50.1,
        *,
        source: str = "sa-1",
        flags: Sequence[tuple[int, ...] | None] | None = None,
        is_stale: Sequence[bool] | None = None,
        index: Sequence[int] | None = None,
        first_seq: int | None = None,
        details: CarrierDetails | None = None,
    ) -> MeasurementBatch:
        """Return a batch; a single power stands for every carrier, one power a row for all carriers of the row."""
        rows = len(epochs_us)
        powers = np.asarray(power_dbm, dtype=np.float32)
        powers = powers[:, None] if powers.ndim == 1 else powers
        return MeasurementBatch(
            self.id,
            source,
            self.plan_id,
            received_at_us=77,
            index=np.arange(rows) if index is None else np.asarray(index, dtype=np.int64),
            epochs_us=np.asarray(epochs_us, dtype=np.int64),
            power_dbm=np.broadcast_to(powers, (rows, len(CARRIERS))),
            flags=tuple(flags) if flags is not None else (None,) * rows,
            is_stale=np.zeros(rows, bool) if is_stale is None else np.asarray(is_stale, dtype=bool),
            first_seq=first_seq,
            details=details,
        )

    def append(self, epochs_us: Sequence[int], power_dbm: object = -50.1, **options: object) -> BatchReceipt:
        """Append a batch and wait for its commit."""
        batch = self.batch(epochs_us, power_dbm, **options)  # type: ignore[arg-type]
        return self.storage.archive.append_measurements(batch).result(timeout=120)

    def rows(self) -> list[Measurement]:
        """Return every stored row."""
        return self.storage.archive.measurements(self.id, ListPart(EVER, 1_000_000))

    def consume(self, outcomes: Sequence[Outcome] = (), version: str = "live") -> int:
        """Store outcomes as if the chain had consumed all there is."""
        head = self.storage.archive.head(self.id)
        return self.storage.results.save_outcomes(self.id, version, outcomes, head.newest_number, head.newest_epoch_us)

    def calibrate(self, method: CalibrationMethod = CalibrationMethod.GEOMETRY) -> Calibration:
        """Store and activate a calibration."""
        results = self.storage.results
        request = CalibrationRequest(Window(0, 10), Window(10, 20), method)
        draft = results.add_calibration(self.id, request, self.plan_id, 1, 5, "engineer")
        observability = Observability(3.0, Axes(1.0, 2.0, 3.0), Axes(float("nan"), 0.1, 0.2))
        result = CalibrationResult((), observability, {"chi_square": 1.25, "worst": float("nan")}, ("few turns",))
        results.finish_calibration(self.id, draft.id, result, None)
        return results.activate_calibration(self.id, draft.id)

    def align(self, epoch_us: int) -> Alignment:
        """Store an alignment under the newest calibration."""
        calibration = self.storage.results.calibrations(self.id)[0]
        zero = Axes(0.0, 0.0, 0.0)
        wanted = Alignment(0, epoch_us, zero, NO_ANGLES, calibration.id, "manual", 6, "approver", ())
        return self.storage.results.add_alignment(self.id, wanted)


def attitude_row(of: Measurement, method: Method = Method.ROBUST, **changes: object) -> AttitudeRow:
    """Return a row with plain figures, none of them NaN: a row that comes back is equal to the one that was stored."""
    figures = {"rates_deg_s": None, "protection_deg": Axes(0.05, 0.01, 0.015), "lag_s": 900.0}
    row = stored_records.attitude_row(of, method=method, inhibitions=("late", "catch_up"), **figures)
    return replace(row, **changes)  # type: ignore[arg-type]


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """URL of a database with the schema and empty tables."""
    if request.param == "sqlite":
        shutil.copy(request.getfixturevalue("empty_database"), tmp_path / "soo.db")
        return f"sqlite:///{tmp_path / 'soo.db'}"
    cluster = request.getfixturevalue("postgresql_cluster")
    return str(cluster.shared_database())


@pytest.fixture
def storage(url: str) -> Iterator[Storage]:
    """A migrated storage."""
    opened = SqlStorage(url)
    yield opened
    opened.close()


@pytest.fixture
def new_setting(storage: Storage) -> Callable[[], Setting]:
    """Return a maker of spacecraft with a plan and an ephemeris, four entries in each journal."""

    def make() -> Setting:
        name = f"craft-{next(_names)}"
        storage.catalogue.add_spacecraft(Spacecraft(name, name, 90.0, Site(55.0, 38.0), INERTIA, 0.05))
        plan = storage.catalogue.put_plan(name, CARRIERS, "sha")
        storage.catalogue.put_ephemeris(name, Ephemeris(0, (1, 2), 86_164.0, 0, 10, "nodes"))
        return Setting(storage, name, plan.id)

    return make


@pytest.fixture
def setting(new_setting: Callable[[], Setting]) -> Setting:
    """One spacecraft with a plan and an ephemeris."""
    return new_setting()


@pytest.fixture
def make() -> SimpleNamespace:
    """Makers of results."""
    return SimpleNamespace(
        attitude_row=attitude_row, torque_command=stored_records.torque_command, ever=EVER, carriers=CARRIERS
    )
