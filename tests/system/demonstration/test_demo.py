"""``soo demo`` as a user starts it, shortened: the spacecraft is kept, its rows are kept and replay to the last bit."""

import csv
import json
import signal
import subprocess
import sys
import time
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path

import pytest
from child_processes import children_of

pytestmark = [pytest.mark.system, pytest.mark.slow]

KEY = "a-key-for-tests-only"
SEED = 1
#: an hour and a half beyond the settling hour; too short for the bounds of estimates, which the whole tour keeps
DAYS = 0.1
#: too short for the harmonics of a day; they hardly matter for hours
QUIET_DAYS = 0.5


def soo(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run one command to its end."""
    command = [sys.executable, "-m", "service", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=540, check=False)


def statistics_of(environment: dict[str, str], *options: str) -> dict:
    """Run a short demonstration and return its figures."""
    print(f"seed {SEED}")
    lengths = ("--days", str(DAYS), "--quiet-days", str(QUIET_DAYS))
    ran = soo(environment, "demo", "--exit", "--json", "--seed", str(SEED), *lengths, *options)
    assert ran.stderr == ""
    assert len(ran.stdout.splitlines()) == 1
    figures = json.loads(ran.stdout)
    assert ran.returncode == bool(figures["missed"])
    return figures


@pytest.fixture(scope="module")
def kept(tmp_path_factory, compiled_environment) -> tuple[Path, dict]:
    """Run the demonstration once; give the folder it kept and its figures."""
    folder = tmp_path_factory.mktemp("demo")
    return folder, statistics_of(compiled_environment, "--keep", str(folder))


def require_whole(figures: dict) -> None:
    """Nothing is lost, nothing invented, live operation equals its replay."""
    assert figures["seed"] == SEED
    assert figures["rows"] == round(DAYS * 1440)
    assert figures["rows_measured"] == figures["rows_archived"] > figures["rows"]
    assert (figures["rows_lost"], figures["rows_not_measured"]) == (0, 0)
    assert figures["replay_rows"] == 2 * figures["rows"], "a row of each method"
    assert figures["replay_rows_different"] == 0


def test_no_row_is_lost_and_live_equals_its_replay(kept):
    require_whole(kept[1])


@pytest.mark.nightly
def test_no_row_is_lost_and_live_equals_its_replay_where_slews_are_followed(compiled_environment):
    figures = statistics_of(compiled_environment, "--open")
    require_whole(figures)
    assert figures["closed_loop"] is None
    # the only bounds that may be missed are those of accuracy
    assert figures["missed"] == figures["estimate_misses"]
    # the tour of slews is there to be followed
    assert all(merit["truth_rms_deg"] > 0.02 for merit in figures["axes"].values())


def test_torques_keep_the_craft_that_leaves_its_bounds_without_them(kept):
    loop = kept[1]["closed_loop"]
    commands = loop["commands"]
    assert commands["sent"] >= commands["executed"] > 20
    assert [commands[name] for name in ("late", "refused", "lost", "twice")] == [0, 0, 0, 0]
    assert loop["bounds_deg"] == {"yaw": 0.5, "roll": 0.3, "pitch": 0.3}
    assert commands["sent"] - commands["executed"] <= 1, "the last one is on its way"
    assert all(0.0 < impulse < 0.1 for impulse in loop["impulse_n_m_s"].values())
    assert (loop["missed"], kept[1]["missed"]) == ([], [])
    alone = loop["control_off"]
    assert alone["missed"]
    assert alone["hours_within_bounds"] < alone["hours"] < 24 * DAYS
    for axis in ("roll", "pitch"):
        assert loop["largest_deg"][axis] < 0.5 * alone["largest_deg"][axis]


def test_the_kept_database_serves_exports_and_replays(kept, start_service, compiled_environment, tmp_path):
    folder, figures = kept
    service = start_service(database=folder / "soo.db")
    environment = {**compiled_environment, "SOO_KEY": KEY}
    with service.client() as client:
        (record,) = client.get("/api/v1/spacecraft").json()["rows"]
        known = record["id"]
        carriers = client.get(f"/api/v1/spacecraft/{known}/carriers").json()["carriers"]
        newest = client.get(f"/api/v1/spacecraft/{known}/status").json()["newest_measurement"]
        alignment = client.get(f"/api/v1/spacecraft/{known}/alignments").json()["rows"][0]["epoch"]
    # what the spacecraft said of its loop, and nothing besides
    reported = record["onboard"]["fed_forward_torque"]
    sizes = [abs(reported[part][axis]) for part in ("cosine_n_m", "sine_n_m") for axis in ("yaw", "roll", "pitch")]
    assert 1e-6 < max(sizes) < 2e-5, "the Sun's light"
    assert record["onboard"]["residual_torque_n_m"] == 0.0
    where = ("--service", service.url, "--spacecraft", known)
    wide = ("--start", "2020-01-01T00:00:00Z", "--stop", "2040-01-01T00:00:00Z")
    table = tmp_path / "measurements.csv"
    ran = soo(environment, "export", *where, "--series", "measurements", *wide, "--output", str(table))
    assert ran.returncode == 0, ran.stderr
    with table.open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["epoch", "source", *(f"{carrier['id']}_dbm" for carrier in carriers)]
    assert len(rows) == 1 + figures["rows_archived"]
    # one row a minute, none left out, from the first to the newest
    assert rows[-1][0] == newest
    instants = [datetime.fromisoformat(row[0]) for row in rows[1:]]
    assert {later - earlier for earlier, later in pairwise(instants)} == {timedelta(minutes=1)}
    ran = soo(
        environment, "replay", *where, "--start", alignment, "--stop", "2040-01-01T00:00:00Z", "--compare", "--json"
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    report = json.loads(ran.stdout)
    assert report["rows_different"] == 0
    assert report["rows_equal"] == report["rows"] >= figures["rows"]


def test_a_folder_with_a_database_is_not_used_again(kept, compiled_environment):
    folder, _ = kept
    ran = soo(compiled_environment, "demo", "--exit", "--keep", str(folder))
    assert ran.returncode == 2
    assert "name another folder" in ran.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_all_its_processes(number, compiled_environment, tmp_path):
    command = [sys.executable, "-m", "service", "demo", "--keep", str(tmp_path / "kept")]
    with (tmp_path / "out").open("wb") as output:
        process = subprocess.Popen(command, env=compiled_environment, stdout=output, stderr=output)
    log = tmp_path / "kept" / "acquire.log"
    try:
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline and not (log.exists() and log.stat().st_size):
            time.sleep(0.05)
        assert log.exists(), (tmp_path / "out").read_text()
        children = children_of(process.pid)
        assert len(children) == 3
        process.send_signal(number)
        assert process.wait(120) == 0, (tmp_path / "out").read_text()
    finally:
        process.kill()
        process.wait()
    assert not [child for child in children if Path(f"/proc/{child}").exists()]
    assert "stopped" in (tmp_path / "out").read_text()
    assert "Traceback" not in (tmp_path / "out").read_text()


@pytest.mark.nightly
def test_two_days_on_a_tour_of_slews_keep_every_bound(compiled_environment):
    print(f"seed {SEED}")
    ran = soo(compiled_environment, "demo", "--open", "--exit", "--json", "--seed", str(SEED))
    print(ran.stdout)
    assert (json.loads(ran.stdout)["missed"], ran.returncode) == ([], 0)
