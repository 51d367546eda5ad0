"""Pages on keeping, restoring and exporting an archive say what the commands do."""

import re
import sqlite3
import subprocess
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_blocks import CARRIERS, CRAFT, run_blocks

from db.maintenance.doctor import CLOCK_TOLERANCE_US, FREE_BYTES_FAULT, FREE_BYTES_WARNING, WAL_BYTES_WARNING
from db.storage import SqlStorage
from service.client.service_client import ServiceClient
from service.ports.archive import ListPart, Outcome
from service.records.calibration import Window
from service.records.catalogue import LIVE_METHODS, Carrier, Method, Site, Spacecraft
from service.records.levels.attitude import AttitudeRow, Axes, Status
from service.records.levels.measurement import Measurement, MeasurementBatch

HOW_TO = Path(__file__).resolve().parents[2] / "docs" / "how-to"
#: what each block prints, in the order of the page
EXPORTED = [
    ("console", '"rows": 3'),
    ("console", '"file": "joined.csv"'),
    ("bash", "epoch,method,yaw_deg"),
    ("bash", '"rows":3'),
    ("python", "3 rows, -42.1 dBm in the mean"),
    ("console", "attitude.aem"),
    ("python", "star_tracker 0 new, 2 known"),
]


@pytest.mark.slow
@pytest.mark.system
def test_exports(service: Any, tmp_path: Path) -> None:
    with ServiceClient(service.url, service.environment["SOO_KEY"], retries=6, timeout_s=120) as client:
        client.create_spacecraft(CRAFT)
        plan = client.put_carriers("yamal-202", CARRIERS)["plan_id"]
        rows = [{"epoch": f"2026-11-19T00:0{k}:00Z", "power_dbm": [-42.0 - k / 10, None]} for k in range(3)]
        assert client.post_measurements("yamal-202", plan, rows, source="sa-1")["accepted"] == 3
        reported = [
            {"epoch": f"2026-11-19T00:0{k}:00Z", "roll_deg": 0.1, "sigma_deg": {"roll": 0.01}} for k in range(2)
        ]
        assert client.post_references("yamal-202", "star_tracker", reported)["accepted"] == 2
    run_blocks(HOW_TO / "export-the-archive.md", EXPORTED, service.environment, tmp_path)


PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "keep-and-restore.md"
TEXT = PAGE.read_text()
#: what each block prints, in the order of the page; those after the restore run without the service
WANTED = ["", "folder: monday.backup", "file", "kept: ", "kept: None", "journal"]
STOPPED_FROM = 3


def blocks() -> list[str]:
    """Return the blocks that can be run."""
    return re.findall(r"^```bash\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)


@pytest.mark.nightly
@pytest.mark.system
@pytest.mark.slow
def test_the_blocks_run_as_they_stand(service: Any, tmp_path: Path) -> None:
    with ServiceClient(service.url, service.environment["SOO_KEY"], retries=6, timeout_s=120) as client:
        client.create_spacecraft(CRAFT)
    assert len(blocks()) == len(WANTED)
    assert (tmp_path / "archive.db").is_file()
    head, *rest = blocks()
    for position, (text, wanted) in enumerate(zip(rest, WANTED[1:], strict=True), start=1):
        script = f"set -e\n{head}{text}"
        if position == STOPPED_FROM:
            refused = run(script, service.environment, tmp_path)
            assert refused.returncode == 1
            assert "stop the service first" in refused.stderr
            subprocess.run(["kill", str(service_pid(tmp_path))], check=True)
        done = run(script, service.environment, tmp_path, until_free=position == STOPPED_FROM)
        # the disk of the tests' machine may have little room
        assert done.returncode in ({0, 3} if "doctor" in text else {0}), done.stderr
        assert wanted in done.stdout
    assert (tmp_path / "elsewhere.db").is_file()
    assert list(tmp_path.glob("archive.db.before-*"))


def test_sizes_are_those_of_the_page(tmp_path: Path) -> None:
    url, count = f"sqlite:///{tmp_path / 'soo.db'}", 10_000
    positions, random = np.arange(count), np.random.default_rng(1)
    level = -50 + 0.3 * np.sin(2 * np.pi * positions[:, None] / 86_400 + np.arange(16))
    power_dbm = (level + 0.05 * random.standard_normal((count, 16))).round(2).astype(np.float32)
    epochs_us = 1_795_219_200_000_000 + positions * 1_000_000
    with_storage = partial(in_storage, url)
    with_storage(prepared)
    sizes = [settled_size(tmp_path / "soo.db")]

    is_stale = np.zeros(1000, dtype=np.bool_)

    def store(storage: SqlStorage) -> None:
        for start in range(0, count, 1000):
            some = slice(start, start + 1000)
            received_us = int(epochs_us[some][-1])
            none = (None,) * 1000
            batch = MeasurementBatch(
                "craft",
                "sa-1",
                1,
                received_us,
                positions[:1000],
                epochs_us[some],
                power_dbm[some],
                none,
                is_stale,
                start,
            )
            storage.archive.append_measurements(batch).result(120)

    def consume(storage: SqlStorage) -> None:
        head = storage.archive.head("craft")
        rows = storage.archive.measurements("craft", ListPart(Window(0, 1 << 60), count))
        outcomes = [Outcome(tuple(result(row, method, random) for method in LIVE_METHODS), None) for row in rows[:2000]]
        storage.results.save_outcomes("craft", "live", outcomes, head.newest_number, head.newest_epoch_us)

    for change in (store, consume, lambda storage: list(storage.archive.seal("craft", 1 << 60, 1 << 60))):
        with_storage(change)
        sizes.append(settled_size(tmp_path / "soo.db"))
    open_row, attitude = (sizes[1] - sizes[0]) / count, (sizes[2] - sizes[1]) / 2000
    sealed = (sizes[3] - sizes[2]) / count + open_row
    reported = [
        float(text) for text in re.findall(r"^\| (?:measurement|attitude), [\w ]+ \| (\d+) \|", TEXT, re.MULTILINE)
    ]
    assert reported == [pytest.approx(figure, rel=0.1) for figure in (open_row, sealed, attitude)]


def in_storage(url: str, change: Callable[[SqlStorage], object]) -> None:
    """Do something to an archive that is opened and closed."""
    storage = SqlStorage(url)
    change(storage)
    storage.close()


def prepared(storage: SqlStorage) -> None:
    """Make an archive with one spacecraft of sixteen carriers."""
    storage.prepare()
    inertia = ((4000.0, 0.0, 0.0), (0.0, 2000.0, 0.0), (0.0, 0.0, 4000.0))
    storage.catalogue.add_spacecraft(Spacecraft("craft", "Craft", 90.0, Site(55.0, 38.0), inertia, 0.05))
    carriers = tuple(Carrier(f"c{k:02}", "Ku", "Ku1", 11e9 + k * 2e6, 1e6) for k in range(16))
    storage.catalogue.put_plan("craft", carriers, "sha")


def result(row: Measurement, method: Method, random: np.random.Generator) -> AttitudeRow:
    """Return an attitude row whose every figure has all its digits."""
    figures = [float(figure) for figure in random.standard_normal(11)]
    return AttitudeRow(
        epoch_us=row.epoch_us,
        received_at_us=row.received_at_us,
        number=row.number,
        method=method,
        attitude_deg=Axes(*figures[:3]),
        sigma_deg=Axes(*figures[3:6]),
        rates_deg_s=Axes(*figures[6:9]) if method is Method.ROBUST else None,
        status=Status.ACQUIRED,
        control_allowed=True,
        control_allowed_axes=(False, True, True),
        inhibitions=(),
        carriers_used=15,
        excluded=(),
        downlink_fade=False,
        downlink_fade_db=0.0,
        common_db=figures[9],
        residual_rms_db=figures[10],
        calibration_id=1,
        alignment_id=1,
    )


def settled_size(path: Path) -> int:
    """Return the size of an archive without the room that was left free."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("VACUUM")
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    connection.close()
    return path.stat().st_size


def run(script: str, environment: dict[str, str], folder: Path, *, until_free: bool = False) -> Any:
    """Run a block; again while a service that was told to stop has not let go yet."""
    command = ["bash", "-c", script]
    done = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, timeout=120)
    while until_free and "stop the service" in done.stderr:
        done = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, timeout=120)
    return done


def service_pid(folder: Path) -> int:
    """Return the process that has the archive of a folder open."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().decode().split("\0")
        except OSError:
            continue
        if "serve" in words and f"sqlite:///{folder / 'archive.db'}" in words:
            return int(path.parent.name)
    raise AssertionError("the service does not run")


def test_limits_and_checks_are_those_of_the_code() -> None:
    assert (FREE_BYTES_WARNING, FREE_BYTES_FAULT, WAL_BYTES_WARNING) == (1 << 30, 64 << 20, 256 << 20)
    assert "less than 1 GiB free (fault below 64 MiB); more than 256 MiB" in TEXT
    assert CLOCK_TOLERANCE_US == 5_000_000
    root = PAGE.parents[2]
    files = (
        "maintenance/integrity_check",
        "maintenance/doctor",
        "measurements/measurement_pages",
    )
    code = "".join((root / f"db/{name}.py").read_text() for name in files)
    made = set(re.findall(r'Diagnosis\("(\w+)"', code))
    reported = {
        name
        for row in re.findall(r"^\| (`\w+`(?:, `\w+`)*) \|", TEXT, re.MULTILINE)
        for name in re.findall(r"`(\w+)`", row)
    }
    assert made == {name for name in reported if not name.startswith("SOO_")}
