"""Times of single computations, each beside the bound asked for; `make bench` runs them on a quiet machine."""

import csv
import io
import socket
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from analyzer_thread import start_in_thread
from calibration_world import CalibratedWorld
from standing_source import StandingSource

from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World
from service.core.dynamics.orbital_frame_flight import Start, fly_spacecraft
from service.core.dynamics.orbital_frame_kernel import compiled_fly
from service.core.dynamics.orbital_frame_model import OrbitalFrameSpacecraft
from service.core.estimation.calibration.quadratic_response import exact_response, predict_deviation
from service.core.estimation.paper.harmonic import fit_harmonics
from service.core.estimation.paper.octants import solve_octants
from service.core.estimation.snapshot.snapshot import solve_snapshots
from service.core.estimation.snapshot.snapshot_start import subset_orders
from service.formats.aem import AemWriter, AttitudeMessage
from service.formats.tabular.row_text import RowFrame, RowText
from service.records.catalogue import Method
from service.records.epoch import US_PER_S, format_epoch
from service.records.levels.attitude import Axes, row_without_attitude

SETUP = (
    b"*RST;*CLS;:INIT:CONT OFF;:FREQ:STAR 954 MHZ;STOP 990 MHZ;:BAND 30 KHZ;:SWE:POIN 2401;TIME 2;:DET RMS;"
    b":FORM REAL,32\n"
)
BLOCK_BYTES = len("#49604") + 4 * 2401 + 1


def least_s(work: Callable[[], object], repeats: int) -> float:
    """Return the least time of several runs."""
    spent = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        spent.append(time.perf_counter() - begin)
    print(f"least of {repeats}: {1e3 * min(spent):.3f} ms")
    return min(spent)


@pytest.mark.parametrize(
    ("name", "limit_s"), [("mixed", 1.5), ("mixed32", 1.5), ("flicker_storm", 1.5), ("long14", 3.0)]
)
def test_worlds_are_built_in_time(name: str, limit_s: float) -> None:
    assert least_s(lambda: World(scenario_named(name), 1), 1) < limit_s


def test_a_calibration_takes_three_seconds() -> None:
    """Three days and the turns, 4830 rows of 16 carriers."""
    assert CalibratedWorld.of("nominal", 1).spent_s < 3.0


def test_a_call_of_the_octants_takes_a_fraction_of_a_millisecond() -> None:
    rng = np.random.default_rng(61)
    steep, deviation_db = rng.normal(0.0, [0.16, 1.4, 1.2], (16, 3)), rng.standard_normal(16)
    assert least_s(lambda: solve_octants(steep - 0.3, steep + 0.3, deviation_db, None), 200) < 600e-6  # 0.14 measured


def test_three_days_of_harmonics_of_sixteen_carriers_take_a_moment() -> None:
    phase_rad = 2.0 * np.pi * np.arange(4320) / 1438.8
    rows_dbm = 0.3 * np.cos(phase_rad)[:, None] - 42.0 + 0.18 * np.random.default_rng(0).normal(size=(4320, 16))
    assert least_s(lambda: fit_harmonics(phase_rad, rows_dbm), 5) < 0.05


def test_a_snapshot_costs_no_more_than_200_batches_of_60_small_systems() -> None:
    rng = np.random.default_rng(9)
    bend = np.broadcast_to(np.diag([-0.1, -2.7, -1.5]), (16, 3, 3))
    model = exact_response(rng.normal(0.0, [0.16, 1.4, 1.2], (16, 3)), bend)
    values = predict_deviation(rng.uniform(-0.3, 0.3, (1, 3)), model) + 0.05 * rng.normal(size=(1, 16))
    orders, sigma = subset_orders(16), np.full(16, 0.05)
    systems, sides = np.eye(4) + np.zeros((60, 4, 4)), np.ones((60, 4, 1))
    batch_s = least_s(lambda: np.linalg.solve(systems, sides), 40)
    assert least_s(lambda: solve_snapshots(model, values, sigma, orders), 40) < 200.0 * batch_s


def test_a_flight_of_15_000_s() -> None:
    kernel = compiled_fly()
    fly_spacecraft(OrbitalFrameSpacecraft(), Start(), 10.0, kernel=kernel)
    assert least_s(lambda: fly_spacecraft(OrbitalFrameSpacecraft(), Start(), 15_000.0, kernel=kernel), 2) < 1.0
    assert 10.0 * least_s(lambda: fly_spacecraft(OrbitalFrameSpacecraft(), Start(), 1500.0), 1) < 30.0


def test_a_day_of_seconds_as_an_attitude_message_in_a_second() -> None:
    start_us = 1_795_219_200 * US_PER_S
    row = replace(
        row_without_attitude(start_us, start_us, 1, Method.ROBUST, ()),
        attitude_deg=Axes(0.0, 0.0, 0.0),
        sigma_deg=Axes(0.08, 0.014, 0.02),
    )
    rows = [replace(row, epoch_us=start_us + US_PER_S * k) for k in range(86_400)]
    message = AttitudeMessage("YAMAL-202", "2003-053B", "m-1", start_us, "robust 1")
    assert least_s(lambda: sum(map(len, AemWriter(message).segments([rows]))), 1) < 1.0


def test_rows_as_text_are_faster_than_the_csv_module() -> None:
    """Asked of the export as a whole: 15 times, see `bench/bench_export.py`."""
    values = np.random.default_rng(2).normal(-60.0, 5.0, (20_000, 16)).round(2).astype(np.float32)
    epochs_us = 1_800_000_000_000_000 + 10_000_000 * np.arange(20_000)
    compiled, frame = RowText("numba"), RowFrame(b"", (b",sa-1",), (b",",) * 16, b"", b"\r\n")
    compiled.rows(epochs_us[:1], values[:1], frame)

    def by_the_module() -> None:
        writer = csv.writer(io.StringIO())
        for epoch_us, row in zip(epochs_us[:2000].tolist(), values[:2000].tolist(), strict=True):
            writer.writerow([format_epoch(epoch_us), "sa-1", *row])

    assert 10.0 * least_s(by_the_module, 3) > 8.0 * least_s(lambda: compiled.rows(epochs_us, values, frame), 3)


def test_sweep_and_trace_take_less_than_two_milliseconds() -> None:
    with start_in_thread(Instrument(StandingSource.endless(), TracePainter(1))) as analyzer:
        line = socket.create_connection(("127.0.0.1", analyzer.port))
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line.sendall(SETUP)
        reader = line.makefile("rb")

        def sweep() -> None:
            line.sendall(b"INIT;*OPC?\n")
            assert reader.readline() == b"1\n"
            line.sendall(b"TRAC? TRACE1\n")
            assert len(reader.read(BLOCK_BYTES)) == BLOCK_BYTES

        assert least_s(sweep, 200) < 2e-3
        reader.close()
        line.close()
