"""A stored archive is opened, exported and estimated from, and gives the values that were stored with it."""

import json
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from fixture_archive import EXPECTED, unpacked, values

from db.maintenance.doctor import diagnose
from db.storage import SqlStorage
from db.tables import LAYOUT

#: estimates of another processor or numpy differ in the last digits, deg and N m s
ANGLE_DEG, IMPULSE_N_M_S = 1e-6, 1e-8
#: after all rows of the archive were received, year 2096
NOW_US = 4_000_000_000_000_000
NEW = "after a change of the layout raise LAYOUT in db/tables.py, then `make archive` makes the archive new"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder with a copy of the archive."""
    made = tmp_path_factory.mktemp("archive")
    unpacked(made)
    return made


def tables_of(path):
    """Return the text of every table, index and trigger."""
    with closing(sqlite3.connect(path)) as connection:
        return dict(connection.execute("SELECT name, sql FROM sqlite_master"))


def test_the_stored_archive_has_the_layout_of_this_program(folder, tmp_path):
    with closing(SqlStorage(f"sqlite:///{tmp_path / 'new.db'}")) as storage:
        storage.prepare()
    with closing(sqlite3.connect(folder / "soo.db")) as connection:
        assert connection.execute("SELECT number FROM archive_layout").fetchone() == (LAYOUT,), NEW
    assert tables_of(folder / "soo.db") == tables_of(tmp_path / "new.db"), NEW


def test_the_stored_archive_is_whole(folder):
    found = diagnose(f"sqlite:///{folder / 'soo.db'}", NOW_US, lambda _: None)
    assert [each for each in found if each.state == "fault"] == [], NEW


def test_the_stored_archive_is_exported_and_estimated_from(folder):
    expected, reached = json.loads(EXPECTED.read_text(encoding="utf-8")), values(folder)
    assert reached["exports"] == expected["exports"], NEW
    assert reached["angles_deg"].keys() == expected["angles_deg"].keys()
    for method, angles in expected["angles_deg"].items():
        stored, computed = (np.array(each, dtype=float) for each in (angles, reached["angles_deg"][method]))
        assert np.isfinite(stored).any()
        np.testing.assert_allclose(computed, stored, rtol=0, atol=ANGLE_DEG, err_msg=f"{method}; {NEW}")
    stored, computed = (np.array(each["impulses_n_m_s"], dtype=float) for each in (expected, reached))
    np.testing.assert_allclose(computed, stored, rtol=0, atol=IMPULSE_N_M_S, err_msg=NEW)
