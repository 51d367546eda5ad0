"""Studies and replays on a Dask cluster of real processes: results of the serial run, lost workers, refusals."""

import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import wait
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from busy_station import SC, Station, at, everything, live_morning_of_states
from child_processes import descendants_of
from typer import Exit
from waiting import wait_until

from service.cli.operation import parallel_replay
from service.composition.bootstrap import storage_opener
from service.composition.settings import Settings
from service.records.operations.work import JobState, Replay
from service.study.executors import ClusterError, WorkerChoice, executor_of

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.nightly]

DASK = Path(sys.executable).parent / "dask"
#: of a hash: ten seconds and more of a processor
ROUNDS = 40_000_000
STUDY = [sys.executable, "-m", "service", "study", "estimation"]
WORLDS = ["--scenario", "white", "--seeds", "2", "--operation-days", "0.1", "--json"]
WANTED = Replay(0, at(1), at(300), None, None, 0, "journal", "", 0)


#: a second before an end: Dask does not always start a worker again that ends while it starts
ENDING = "__import__('time').sleep(1.0), __import__('os')._exit(1)"


@contextmanager
def processes(folder, *commands, **environment):
    """Run processes whose output goes to files, and end them."""
    running = []
    try:
        for number, command in enumerate(commands):
            with (folder / f"{command[0]}-{number}.log").open("wb") as log:
                place = {"cwd": folder, "env": {**os.environ, **environment}}
                running.append(subprocess.Popen([DASK, *command], stdout=log, stderr=log, **place))
        yield
    finally:
        for process in running:
            process.terminate()
        for process in running:
            process.wait(60)


@contextmanager
def scheduled(folder, patience="120s"):
    """Give the address of a scheduler without workers, on which pieces wait for one as long as it has patience."""
    file = folder / "scheduler.json"
    where = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
    with processes(folder, ["scheduler", *where], DASK_DISTRIBUTED__SCHEDULER__NO_WORKERS_TIMEOUT=patience):
        wait_until(lambda: file.is_file() and file.read_text().endswith("}"))
        yield json.loads(file.read_text())["address"]


def worker(address, *options):
    return ["worker", address, "--nthreads", "1", "--no-dashboard", "--memory-limit", "1GB", *options]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Address of a scheduler with two workers, each with a watch of its own."""
    folder = tmp_path_factory.mktemp("cluster")
    with scheduled(folder) as address, processes(folder, worker(address), worker(address), OPENBLAS_NUM_THREADS="1"):
        wait_until(lambda: has_workers(address))
        yield address


def has_workers(address):
    try:
        with executor_of(WorkerChoice(scheduler=address)):
            return True
    except ClusterError:
        return False


@pytest.fixture
def pool(cluster):
    """Executor of the cluster, whose workers may still come back from the test before."""
    wait_until(lambda: has_workers(cluster))
    with executor_of(WorkerChoice(scheduler=cluster)) as executor:
        yield executor


def study(*options):
    ran = subprocess.run([*STUDY, *WORLDS, *options], capture_output=True, text=True, timeout=540, check=False)
    return ran.returncode, ran.stdout, ran.stderr


def test_a_study_on_a_cluster_has_the_figures_of_processes(cluster, pool):
    documents = []
    for options in (["--scheduler", cluster], ["--workers", "2"]):
        code, output, error = study(*options)
        # 1: an operation of some hours is too short for bounds that were set for two days
        assert code in (0, 1), error
        documents.append(json.loads(output))
        documents[-1].pop("seconds")
    assert documents[0] == documents[1]


def test_what_a_killed_worker_computed_is_computed_again(pool):
    first = pool.submit(eval, "__import__('time').sleep(1.0) or __import__('os').getpid()").result(120)
    pieces = [pool.submit(time.sleep, 1.0 + 0.01 * number) for number in range(6)]
    os.kill(first, signal.SIGKILL)
    done, left = wait(pieces, 240)
    assert (len(done), len(left)) == (6, 0)
    assert [piece.result() for piece in pieces] == [None] * 6


def test_a_piece_that_ends_every_worker_is_reported(pool):
    with pytest.raises(ClusterError, match="worker after worker ended over the same piece, for lack of memory"):
        pool.submit(eval, ENDING).result(540)


def test_a_piece_whose_workers_are_gone_is_reported(tmp_path):
    with (
        scheduled(tmp_path, "5s") as address,
        processes(tmp_path, worker(address, "--no-nanny"), OPENBLAS_NUM_THREADS="1"),
    ):
        wait_until(lambda: has_workers(address))
        with (
            executor_of(WorkerChoice(scheduler=address)) as executor,
            pytest.raises(ClusterError, match="no worker is left, for 5"),
        ):
            executor.submit(eval, ENDING).result(120)


def test_a_piece_that_needs_more_memory_than_a_worker_has_is_reported(pool):
    """Each worker that takes it is ended by its own watch, at 0.95 of 1 GB."""
    with pytest.raises(ClusterError, match="for lack of memory"):
        pool.submit(eval, "[bytearray(1 << 30).replace(b'a', b'b'), __import__('time').sleep(60)]").result(540)


def test_errors_of_the_work_are_those_of_the_work(pool):
    with pytest.raises(ZeroDivisionError):
        pool.submit(divmod, 1, 0).result(120)


def test_a_scheduler_that_is_not_there_or_has_no_worker_is_reported(tmp_path):
    code, output, error = study("--scheduler", "tcp://127.0.0.1:1")
    assert (code, output) == (2, "")
    assert "no scheduler answers at tcp://127.0.0.1:1: start `dask scheduler`" in error
    assert "Traceback" not in error
    with scheduled(tmp_path) as address:
        code, _, error = study("--scheduler", address)
    assert code == 2
    assert f"the scheduler at {address} has no worker: start `dask worker {address} --nthreads 1`" in error


def test_a_worker_that_could_compute_other_digits_is_refused(tmp_path):
    with (
        scheduled(tmp_path) as address,
        processes(tmp_path, worker(address, "--no-nanny"), OPENBLAS_NUM_THREADS="2"),
    ):
        wait_until(lambda: has_workers(address))
        code, output, error = study("--scheduler", address)
    assert (code, output) == (2, "")
    assert "OPENBLAS_NUM_THREADS not set to 1: bring it to the state of this machine" in error


def processor_s():
    """Return the processor time of this process and of all below it, ended ones too."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    ticks = 0
    for process_id in descendants_of(os.getpid()):
        with suppress(OSError):
            ticks += sum(map(int, Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[11:15]))
    return time.process_time() + ended.ru_utime + ended.ru_stime + ticks / os.sysconf("SC_CLK_TCK")


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_pieces_of_ten_seconds_cost_no_more_on_a_cluster_than_in_processes(cluster, pool):
    used_s = []
    for workers in (WorkerChoice(2), WorkerChoice(scheduler=cluster)):
        began_s = processor_s()
        with executor_of(workers) as executor:
            wait([executor.submit(hashlib.pbkdf2_hmac, "sha256", b"", bytes([k]), ROUNDS) for k in range(4)])
        used_s.append(processor_s() - began_s)
    print(f"four pieces in processes {used_s[0]:.1f} s, on a cluster {used_s[1]:.1f} s: {used_s[1] / used_s[0]:.3f}")
    assert used_s[0] > 30.0
    assert used_s[1] < 1.05 * used_s[0]


# ---- replays


@pytest.fixture(scope="module")
def lived(tmp_path_factory):
    directory = tmp_path_factory.mktemp("lived") / "archive"
    directory.mkdir()
    station = Station(directory)
    station.open()
    station.close()
    live_morning_of_states(directory)
    return directory


@pytest.fixture
def station(lived, tmp_path, monkeypatch):
    monkeypatch.setattr(parallel_replay, "LEAST_ENTRIES", 8)
    shutil.copytree(lived, tmp_path / "copy")
    station = Station(tmp_path / "copy")
    yield station
    station.close()


def replayed(station, workers):
    """Replay the morning in parts; return the version and how often progress was shown."""
    settings = Settings(database_url=station.url)
    shown = []
    replay = parallel_replay.replay_in_parts(settings, SC, WANTED, workers, shown.append)
    assert shown[-1] == 1.0
    return replay.version, len(shown)


def test_replays_by_processes_and_by_a_cluster_are_the_serial_one(station, cluster, pool):
    whole = everything(station, station.replay(1, 300))
    assert whole[0] > 200
    for workers in (WorkerChoice(2), WorkerChoice(scheduler=cluster)):
        version, spans = replayed(station, workers)
        assert everything(station, version) == whole
        assert spans >= 5


def test_a_replay_that_fails_leaves_a_version_that_nobody_reads(station, tmp_path, monkeypatch, capsys):
    # workers on another machine, which has no such file
    elsewhere = storage_opener(Settings(database_url=f"sqlite:///{tmp_path / 'none.db'}"))
    monkeypatch.setattr(parallel_replay, "storage_opener", lambda _settings: elsewhere)
    with pytest.raises(Exit) as ended:
        replayed(station, WorkerChoice(2))
    assert ended.value.exit_code == 1
    assert f"replay-1 failed: there is no file {tmp_path / 'none.db'}" in capsys.readouterr().err
    assert station.storage.results.replay(SC, "replay-1").state is JobState.FAILED
