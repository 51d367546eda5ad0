"""The chain with both methods, with operations and with odd input."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import MINUTE, Flight
from geometry_payload import GeometryPayload
from stepped_robust import ALIGNED_US, PAYLOAD, Stepped

from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.calibration.geometry_rows import CalibrationError
from service.pipeline.chain import Chain
from service.pipeline.config import CalibrationConfig, ChainConfig
from service.pipeline.estimation.paper.runner import PaperRunner
from service.pipeline.inputs.knowledge import Knowledge
from service.records.calibration import CalibrationMethod
from service.records.catalogue import CarrierPlan, Method, Station, Track
from service.records.inputs import (
    AlignmentSet,
    CalibrationActivation,
    Correction,
    Operation,
    PlanChange,
    SpacecraftChange,
    TelemetryRecord,
)
from service.records.levels.attitude import Axes, Status

BOTH = (Method.ROBUST, Method.PAPER)
NAN = float("nan")


@pytest.fixture
def flight():
    """A chain just aligned."""
    return Flight(PAYLOAD)


def by_paper(payload, calibration_id):
    calibration = payload.calibration(calibration_id)
    request = replace(calibration.request, method=CalibrationMethod.PAPER)
    return replace(calibration, request=request, result=replace(calibration.result, geometry=None))


def noisy(flight, minute, seed=3):
    noise = 0.05 * np.random.default_rng((seed, minute)).normal(size=len(flight.payload.ids))
    return flight.changed(minute, noise)


# ---- both -----------------------------------------------------------------------------------------------------------


def test_every_row_has_one_of_each_method_robust_first(flight):
    for minute in range(1, 20):
        outcome = flight.chain.step(flight.row(minute))
        assert tuple(row.method for row in outcome.rows) == BOTH
        assert {(row.epoch_us, row.number) for row in outcome.rows} == {(flight.at(minute), flight.row(minute).number)}
        assert outcome.command.attitude_epoch_us == flight.at(minute)
    assert all(row.status is Status.ACQUIRED for row in outcome.rows)


def test_each_method_alone_says_what_it_says_beside_the_other(flight):
    alone = {method: Flight(PAYLOAD, methods=(method,)) for method in BOTH}
    for minute in range(1, 60):
        reported = flight.feed(noisy(flight, minute))
        for method, one in alone.items():
            # the text of a record holds every digit of every float, and tells NaN
            assert repr(one.feed(noisy(one, minute))) == repr({method: reported[method]})


def test_the_method_that_drives_control_makes_the_command(flight):
    flight.run(range(1, 30))
    robust = flight.chain.step(flight.row(30)).command
    record = PAYLOAD.spacecraft(method=Method.PAPER)
    flight.chain.update(SpacecraftChange(record, 2))
    outcome = flight.chain.step(flight.row(31))
    paper = outcome.command
    assert robust.control_allowed
    assert robust.inhibitions == ()
    assert outcome.rows[1].inhibitions == paper.inhibitions


def test_a_replay_of_the_other_method_alone_makes_no_command():
    flight = Flight(PAYLOAD, methods=(Method.PAPER,))
    assert flight.chain.step(flight.row(1)).command is None
    driving = Flight(PAYLOAD, methods=(Method.ROBUST,))
    assert driving.chain.step(driving.row(1)).command.control_allowed


# ---- one of them cannot ---------------------------------------------------------------------------------------------


def test_without_a_calibration_by_geometry_the_robust_method_is_silent_and_its_command_zero(flight):
    bare = Flight(PAYLOAD, is_opened=False)
    bare.documents.calibrations[1] = by_paper(PAYLOAD, 1)
    reported = PAYLOAD.alignment(bare.aligned_us).references_by_method["paper"]
    bare.documents.alignments[1] = PAYLOAD.alignment(
        bare.aligned_us,
        references=reported,
        references_by_method={"paper": reported},
        calibration_by_method={"paper": 1},
    )
    for content in bare.opening():
        bare.chain.update(content)
    outcome = bare.chain.step(bare.row(1))
    assert [row.method for row in outcome.rows] == [Method.PAPER]
    assert outcome.command.inhibitions == ("no_calibration",)
    # activated after the alignment it still has no references: only a new alignment starts it
    bare.documents.calibrations[2] = PAYLOAD.calibration(2)
    bare.chain.update(CalibrationActivation(2, 2))
    outcome = bare.chain.step(bare.row(2))
    assert [row.method for row in outcome.rows] == [Method.PAPER]
    assert outcome.command.inhibitions == ("not_aligned",)
    assert not outcome.command.control_allowed
    bare.documents.alignments[2] = PAYLOAD.alignment(
        bare.at(2), 2, 2, bare.truth_deg.tolist(), calibration_by_method={"robust": 2, "paper": 1}
    )
    bare.chain.update(AlignmentSet(2))
    assert tuple(row.method for row in bare.chain.step(bare.row(3)).rows) == BOTH


@pytest.mark.parametrize("failing", BOTH, ids=str)
def test_a_method_that_fails_says_so_in_its_row_and_the_other_goes_on(flight, monkeypatch, caplog, failing):
    plain = Flight(PAYLOAD)
    for one in (flight, plain):
        one.run(range(1, 20))
    runner = next(one for one in flight.chain._runners if one.method is failing)
    real = type(runner).steps

    def broken(self, measurements, **options):
        if self is runner:
            raise np.linalg.LinAlgError
        return real(self, measurements, **options)

    monkeypatch.setattr(type(runner), "steps", broken)
    reported, wanted = flight.feed(noisy(flight, 20)), plain.feed(noisy(plain, 20))
    other = next(method for method in BOTH if method is not failing)
    assert repr(reported[other]) == repr(wanted[other])
    row = reported[failing]
    assert (row.status, row.inhibitions, row.control_allowed) == (Status.INVALID, ("internal_error",), False)
    assert np.isnan(row.attitude_deg).all()
    assert f"method {failing} failed at journal number" in caplog.text
    monkeypatch.undo()
    assert flight.feed(noisy(flight, 21))[failing].status is Status.ACQUIRED


def test_when_the_driving_method_fails_the_command_is_zero(flight, monkeypatch):
    flight.run(range(1, 20))

    def broken(*_args, **_options):
        raise ArithmeticError

    monkeypatch.setattr("service.pipeline.estimation.robust.runner.steps_in_time", broken)
    command = flight.chain.step(flight.row(20)).command
    assert command.inhibitions == ("internal_error",)
    assert command.schedule == ()


def test_the_paper_method_does_not_step_before_it_has_a_model(flight):
    runner = PaperRunner(flight.documents, ChainConfig())
    assert (runner.is_running, runner.carrier_states()) == (False, {})
    runner.rebuild(Knowledge())
    with pytest.raises(ValueError, match="without a model"):
        runner.steps([flight.row(1)], PAYLOAD.plan(), Knowledge(), is_late=False, is_catch_up=False)


def test_without_the_robust_method_carriers_are_known_by_the_paper_method():
    flight = Flight(PAYLOAD, methods=(Method.PAPER,))
    for minute in range(1, 12):
        flight.feed(flight.row(minute))
    states = {state.carrier: state.state for state in flight.chain.carrier_states()[1]}
    assert states == dict.fromkeys(PAYLOAD.ids, "used")


# ---- late rows, order, poison ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("minute", "changes"),
    [
        pytest.param(35, {"is_late": True}, id="late when stored"),
        pytest.param(12, {}, id="older than the newest"),
        pytest.param(30, {"source": "sa-2"}, id="the newest epoch again"),
        pytest.param(-10, {}, id="before the alignment"),
    ],
)
def test_a_late_row_leaves_everything_after_it_bit_for_bit(flight, minute, changes):
    plain = Flight(PAYLOAD)
    for one in (flight, plain):
        for k in range(1, 31):
            one.feed(noisy(one, k))
    known = repr(flight.chain.carrier_states())
    outcome = flight.chain.step(flight.row(minute, (0.0, -0.2, 0.2), **changes))
    assert outcome.command is None
    assert all("late" in row.inhibitions for row in outcome.rows)
    assert repr(flight.chain.carrier_states()) == known
    for k in range(31, 60):
        assert repr(flight.chain.step(noisy(flight, k))) == repr(plain.chain.step(noisy(plain, k)))


# ---- plans ----------------------------------------------------------------------------------------------------------


def test_a_plan_that_changes_in_operation_keeps_the_references_of_those_that_stay(flight):
    plain = Flight(PAYLOAD)
    flight.run(range(1, 30))
    plain.run(range(1, 30))
    carriers = list(PAYLOAD.carriers())
    # two go, one id is given to another station, two are new, the order is turned round
    carriers[3] = replace(carriers[3], station=Station(43.1, 131.9))
    new = [replace(carriers[0], id=name, transponder="Ku9") for name in ("n1", "n2")]
    order = [k for k in range(15, -1, -1) if k not in (6, 11)]
    flight.documents.plans[2] = CarrierPlan(2, "sha-2", (new[0], *(carriers[k] for k in order), new[1]))
    flight.chain.update(PlanChange(2))
    gone = np.where(np.isin(np.arange(16), (3, 6, 11)), NAN, 0.0)
    for minute in range(30, 100):
        row = flight.row(minute)
        power = np.array([-20.0, *(row.power_dbm[k] + 9.0 * (k == 3) for k in order), NAN])
        reported = flight.feed(replace(row, plan_id=2, power_dbm=power))
        # the same as if the three had fallen silent
        wanted = plain.feed(plain.changed(minute, gone))
        assert repr(reported[Method.ROBUST]) == repr(wanted[Method.ROBUST])
    row = reported[Method.ROBUST]
    assert {(item.carrier, item.reason) for item in row.excluded} == {(f"c{k:02d}", "absent") for k in (3, 6, 11)}
    np.testing.assert_allclose(flight.error_deg(row), 0.0, atol=0.01)
    states = {state.carrier: state.state for state in flight.chain.carrier_states()[1]}
    assert (states["n1"], states["n2"], states["c00"]) == ("uncalibrated", "absent", "used")


def test_a_calibration_of_the_new_plan_goes_on_where_the_old_one_stood(flight):
    flight.run(range(1, 60))
    order = [k for k in range(15, -1, -1) if k not in (6, 11)]
    fewer = PAYLOAD.permuted(order)
    flight.documents.plans[2] = fewer.plan(2)
    flight.documents.calibrations[2] = fewer.calibration(2, plan_id=2)
    flight.chain.update(PlanChange(2))
    flight.chain.update(CalibrationActivation(2, 2))
    for minute in range(60, 90):
        row = flight.robust(replace(flight.row(minute), plan_id=2, power_dbm=flight.row(minute).power_dbm[order]))
        np.testing.assert_allclose(flight.error_deg(row), 0.0, atol=0.01)
        assert (row.carriers_used, row.calibration_id, row.control_allowed) == (14, 2, True)


# ---- disagreement ---------------------------------------------------------------------------------------------------


def test_methods_that_are_apart_for_long_disagree(flight):
    reported = PAYLOAD.alignment(flight.aligned_us, angles_deg=flight.truth_deg.tolist())
    slope = np.array([one.sensitivity_db_per_deg.roll for one in flight.documents.calibrations[1].result.carriers])
    wrong = tuple(
        replace(one, reference_dbm=one.reference_dbm + 0.25 * by)
        for one, by in zip(reported.references_by_method["paper"], slope, strict=True)
    )
    references = {**reported.references_by_method, "paper": wrong}
    flight.documents.alignments[1] = replace(reported, references_by_method=references)
    flight.chain.update(AlignmentSet(1))
    assert not flight.chain.is_disagreeing
    apart = []
    for minute in range(1, 40):
        flight.run([minute])
        apart.append(flight.chain.is_disagreeing)
    # the paper method settles for seven minutes, then a quarter of an hour passes
    assert not any(apart[:21])
    assert all(apart[23:])
    flight.documents.alignments[2] = PAYLOAD.alignment(flight.at(40), 2, angles_deg=flight.truth_deg.tolist())
    flight.chain.update(AlignmentSet(2))
    assert not flight.chain.is_disagreeing


def test_before_anything_nothing_disagrees():
    assert not Chain(Flight(PAYLOAD).documents, ChainConfig()).is_disagreeing


# ---- a replay's own calibration -------------------------------------------------------------------------------------


def test_a_replay_may_bring_its_own_calibration(flight):
    doubled = replace(PAYLOAD, gradient=2.0 * PAYLOAD.gradient, hessian=4.0 * PAYLOAD.hessian)
    chain = Chain(flight.documents, ChainConfig(), doubled.calibration(9), (Method.ROBUST,))
    for content in flight.opening():
        chain.update(content)
    row = chain.step(flight.row(1)).rows[0]
    assert (row.calibration_id, row.alignment_id) == (9, 1)
    np.testing.assert_allclose(flight.error_deg(row), 0.0, atol=0.02)


def test_a_row_after_a_gap_catches_up_with_what_was_commanded_meanwhile(flight):
    flight.run(range(1, 10))
    flight.chain.update(Correction(flight.at(30), flight.at(50), Axes(0.0, 0.1, 0.0)))
    row = flight.robust(flight.row(90, flight.truth_deg + np.array([0.0, 0.1, 0.0])))
    np.testing.assert_allclose(flight.error_deg(row), [0.0, 0.1, 0.0], atol=0.01)


def declared(stepped, kind, start, stop, **changes):
    operation = Operation(1, kind, ALIGNED_US + start * MINUTE, ALIGNED_US + stop * MINUTE, **changes)
    stepped.knowledge = stepped.knowledge._replace(operations={1: operation})


def test_carriers_that_are_worked_on_are_masked_and_come_back_at_another_level():
    stepped = Stepped(angles=(0.0, 0.1, -0.1))
    declared(stepped, "carrier_work", 30, 40, carriers=("c01", "c02"))
    for minute in range(1, 30):
        stepped.step(minute)
    during = np.where(np.isin(np.arange(16), [1, 2]), -15.0, 0.0)
    rows = [stepped.step(minute, during).row for minute in range(30, 40)]
    for row in rows:
        assert [(item.carrier, item.reason) for item in row.excluded] == [("c01", "manual"), ("c02", "manual")]
        np.testing.assert_allclose(row.attitude_deg, [0.0, 0.1, -0.1], atol=0.01)
        assert row.control_allowed
    after = np.where(np.isin(np.arange(16), [1, 2]), 1.5, 0.0)
    back = [stepped.step(minute, after).row for minute in range(40, 60)]
    assert {row.carriers_used for row in back} == {16}
    np.testing.assert_allclose([row.attitude_deg for row in back], np.tile([0.0, 0.1, -0.1], (20, 1)), atol=0.01)


def test_a_declared_change_of_gain_moves_no_angle_and_flags_no_carrier():
    stepped = Stepped(angles=(0.0, 0.1, -0.1))
    declared(stepped, "gain_change", 30, 50, transponders=("Ku1",))
    own = np.array([name == "Ku1" for name in PAYLOAD.transponders])
    for minute in range(1, 80):
        row = stepped.step(minute, np.where(own & (30 <= minute < 50), 1.4, 0.0)).row
        np.testing.assert_allclose(row.attitude_deg, [0.0, 0.1, -0.1], atol=0.01)
        assert row.carriers_used == 16


def test_thrusters_that_act_undeclared_forbid_control_by_both_methods(flight):
    flight.run(range(1, 10))
    assert all("undeclared_operation" not in row.inhibitions for row in flight.chain.step(flight.row(10)).rows)
    flight.chain.update(TelemetryRecord(flight.at(11), thrusters_active=True))
    rows = flight.chain.step(flight.row(11)).rows
    assert len(rows) == 2
    assert all("undeclared_operation" in row.inhibitions and not row.control_allowed for row in rows)
    flight.chain.update(Operation(1, "momentum_unloading", flight.at(11), flight.at(20)))
    rows = flight.chain.step(flight.row(12)).rows
    assert all("undeclared_operation" not in row.inhibitions for row in rows)


def test_work_on_the_receiving_chain_holds_control_at_both_ends():
    stepped = Stepped()
    declared(stepped, "receive_chain_work", 30, 60)
    rows = [stepped.step(minute, -1.0 if 30 <= minute < 60 else 0.0).row for minute in range(1, 90)]
    assert rows[28].control_allowed
    assert "chain_step" in rows[29].inhibitions
    assert "chain_step" in rows[59].inhibitions
    assert rows[75].control_allowed
    assert not any(row.downlink_fade for row in rows)
    np.testing.assert_allclose([row.attitude_deg for row in rows], 0.0, atol=0.01)


@pytest.mark.parametrize("kind", ["station_keeping", "momentum_unloading", "calibration_turn"])
def test_an_operation_that_turns_the_craft_widens_sigma_and_is_followed(kind):
    quiet, turned = Stepped(), Stepped()
    declared(turned, kind, 30, 40, inhibit_control=True)
    moved = np.array([0.0, 0.06, -0.05])
    for minute in range(1, 120):
        plain = quiet.step(minute).row
        share = np.clip((minute - 30) / 10, 0.0, 1.0)
        row = turned.step(minute, angles=share * moved).row
        assert ("operation" in row.inhibitions) == (30 <= minute < 40)
        if minute == 40:
            assert (np.array(row.sigma_deg) > 1.2 * np.array(plain.sigma_deg)).all()
    np.testing.assert_allclose(row.attitude_deg[1:], moved[1:], atol=0.01)


def test_an_eclipse_lets_gains_walk_and_the_attitude_stays():
    stepped = Stepped()
    declared(stepped, "eclipse", 30, 100)
    label = np.array([int(name == "Ku2") for name in PAYLOAD.transponders])
    for minute in range(1, 200):
        cooled = (
            -0.4 * (1.0 - np.exp(-max(0, minute - 30) / 20)) if minute < 100 else -0.4 * np.exp(-(minute - 100) / 20)
        )
        row = stepped.step(minute, cooled * label).row
        assert row.carriers_used == 16
        np.testing.assert_allclose(row.attitude_deg[1:], 0.0, atol=0.02)


def test_a_sun_outage_masks_everything():
    stepped = Stepped()
    stepped.step(1)
    declared(stepped, "sun_outage", 2, 5)
    row = stepped.step(2, 5.0).row
    assert {item.reason for item in row.excluded} == {"manual"}
    assert row.status is Status.EXPIRED
    assert stepped.step(5).row.status is Status.ACQUIRED


SEED = 3


def powers(data, change):
    parts = [replace(part, power_dbm=change(part.power_dbm.copy())) for part in (data.quiet, data.turns)]
    return replace(data, quiet=parts[0], turns=parts[1])


def holes(data, share):
    rng = np.random.default_rng(SEED)
    return powers(data, lambda power: np.where(rng.random(power.shape) < share, np.nan, power))


def thinned(data, step):
    parts = [
        replace(part, epochs_us=part.epochs_us[::step], power_dbm=part.power_dbm[::step])
        for part in (data.quiet, data.turns)
    ]
    return replace(data, quiet=parts[0], turns=parts[1])


def angles(data, change):
    reported = [
        tuple(replace(one, attitude_deg=change(one.attitude_deg.copy())) for one in series)
        for series in (data.references, data.quiet_references)
    ]
    return replace(data, references=reported[0], quiet_references=reported[1])


def tracked(data, start, stop):
    reported = data.ephemeris.track
    cut = slice(start, stop)
    track = Track(reported.epochs_us[cut], reported.latitude_deg[cut], reported.longitude_deg[cut])
    return replace(data, ephemeris=replace(data.ephemeris, track=track))


def carriers(data, change):
    plan = replace(data.plan, carriers=tuple(change(k, one) for k, one in enumerate(data.plan.carriers)))
    return replace(data, plan=plan)


def wild(power):
    return power + 10.0 * np.random.default_rng(SEED).normal(size=power.shape)


#: name, change, and the words of a refusal or None for figures
CASES = {
    "no noise at all": (lambda _: GeometryPayload.make(6, quiet_days=0.5).data(0.0, 0.0), None),
    "powers that never change": (lambda data: powers(data, lambda power: np.full_like(power, -42.0)), None),
    "powers of noise": (lambda data: powers(data, wild), None),
    "half of the samples": (lambda data: holes(data, 0.5), None),
    "one sample in thirty": (lambda data: holes(data, 0.97), None),
    "one sample in two hundred": (lambda data: holes(data, 0.995), "carriers can be used"),
    "rows of three minutes": (lambda data: thinned(data, 3), None),
    "rows of five minutes": (lambda data: thinned(data, 5), "the quiet window holds 144 measurements"),
    "angles that never change": (lambda data: angles(data, np.zeros_like), "no turn of at least 0.1 deg in roll"),
    "a yaw that nobody tells": (
        lambda data: angles(data, lambda reported: np.where([True, False, False], np.nan, reported)),
        "only 0 rows of the quiet window have angles",
    ),
    "a track of three points": (lambda data: tracked(data, 0, 3), None),
    "an empty track": (lambda data: tracked(data, 0, 0), None),
    "a track of another time": (lambda data: tracked(data, 0, 40), None),
    "one station for all": (
        lambda data: carriers(data, lambda _, one: replace(one, station=Station(55.0, 60.0))),
        None,
    ),
    "beacons only": (
        lambda data: carriers(data, lambda _, one: replace(one, station=None, kind="beacon")),
        "only 0 carriers can be used",
    ),
    "one transponder under level control": (
        lambda data: carriers(data, lambda _, one: replace(one, transponder="T", transponder_mode="alc")),
        None,
    ),
    "a band for two carriers": (lambda data: carriers(data, lambda k, one: replace(one, band=f"B{k % 3}")), None),
    "one window for both": (
        lambda data: replace(data, quiet=data.turns, request=replace(data.request, quiet=data.request.turns)),
        "the quiet window holds 0 measurements",
    ),
}


@pytest.fixture(scope="module")
def data():
    """Half a quiet day of six carriers."""
    return GeometryPayload.make(6, quiet_days=0.5).data()


@pytest.mark.parametrize("name", CASES)
def test_figures_or_words(data, name):
    change, refusal = CASES[name]
    if refusal is not None:
        with pytest.raises(CalibrationError, match=refusal):
            calibrate_geometry(change(data), CalibrationConfig())
        return
    result = calibrate_geometry(change(data), CalibrationConfig())
    fit = result.geometry
    used = np.array(fit.is_used)
    assert np.count_nonzero(used) >= 4
    for table in (fit.level_dbm, fit.daily, fit.gradient, fit.hessian, fit.covariance, fit.solar_day_db):
        assert np.isfinite(np.array(table)[used]).all()
    assert all(np.isfinite(carrier.sigma_white_db) and carrier.sigma_white_db > 0.0 for carrier in result.carriers)
    assert result.warnings, "twelve hours are short, whatever else"
