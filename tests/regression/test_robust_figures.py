"""Figures of the robust method and of its filter."""

from typing import NamedTuple

import numpy as np
import pytest
import robust_world
from driven_world import shared_world

from analyzer_sim.export import export_arrays
from analyzer_sim.world.payload.level_terms import nominal_gain_db
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World
from service.core.estimation.calibration.geometry_calibration import (
    CalibrationRows,
    GeometryCalibration,
    fit_geometry,
    predict_level_dbm,
    response_of,
)
from service.core.estimation.calibration.geometry_columns import (
    CarrierGeometry,
    OrbitMotion,
    QuadraticResponse,
    exact_response,
    predict_deviation,
    predict_jacobian,
)
from service.core.estimation.design import choose_carriers
from service.core.estimation.filtering.filter_model import FilterSettings
from service.core.estimation.observability import crlb_deg
from service.core.estimation.snapshot import CarrierUse, solve_snapshots, subset_orders
from service.core.geometry.frames import station_direction
from service.core.geometry.line_of_sight import (
    Positions,
    PredictedTrack,
    antenna_motion_deg,
    sight_motion_deg,
    track_position_deg,
)

LONGITUDE_DEG = 90.0
#: dB, 15 rows of 0.1857 dB
SIGMA_DB = 0.048
SLOPE_SEEDS = range(1, 9)


class Calibrated(NamedTuple):
    world: World
    white_db: np.ndarray
    fit: GeometryCalibration
    geometry: CarrierGeometry
    response: QuadraticResponse

    def truth_db(self, attitude_deg):
        """Deviations of the simulator's beams without noise."""
        attitudes = np.concatenate([np.zeros((1, 3)), attitude_deg])
        gains = nominal_gain_db(self.world.plan, self.world.orbit, attitudes)
        return gains[1:] - gains[0]


def motion_at(file, epochs_us, positions):
    """Ballistics of the exported track; the receiving site comes last in `places`."""
    track = PredictedTrack(file["track_epoch_us"], file["track_latitude_deg"], file["track_longitude_deg"])
    users = Positions(*(column[:-1] for column in positions))
    sight = sight_motion_deg(track_position_deg(track, epochs_us), users, LONGITUDE_DEG)
    return OrbitMotion(sight, antenna_motion_deg(track, epochs_us, positions, LONGITUDE_DEG))


def positions_of(world):
    stations = [carrier.station for carrier in world.plan.carriers] + [world.plan.receiving_site]
    names = ("latitude_deg", "longitude_deg", "height_m")
    return Positions(*(np.array([getattr(station, name) for station in stations]) for name in names))


def calibrated(name, seed):
    """Calibrate on the quiet days and the turns of a world."""
    world = World(scenario_named(name, operation_days=0.1), seed)
    file = export_arrays(world)
    positions = positions_of(world)
    azimuth, elevation = station_direction(
        positions.longitude_deg, positions.latitude_deg, positions.height_m, LONGITUDE_DEG
    )
    carriers = len(world.carrier_ids)
    site = np.array([azimuth[-1], elevation[-1]])
    geometry = CarrierGeometry(azimuth[:-1], elevation[:-1], site, np.zeros(carriers, dtype=int))
    count = int(np.searchsorted(file["epoch_us"], file["phase_stop_us"][1]))
    epochs_us = file["epoch_us"][:count]
    angles = np.column_stack([file[f"reference_{axis}_deg"] for axis in ("yaw", "roll", "pitch")])[:count]
    motion = motion_at(file, epochs_us, positions)
    rows = CalibrationRows((epochs_us - epochs_us[0]) / 1e6, file["power_dbm"][:count], angles, np.zeros(count), motion)
    fit = fit_geometry(rows, geometry)
    return Calibrated(world, file["white_db"], fit, geometry, response_of(fit, geometry))


def quadratic_of(world):
    """Slope and curvature of the simulator's beams at zero attitude, by differences."""
    step = 0.05
    shifts = step * np.concatenate([np.eye(3), -np.eye(3)])
    pairs = (shifts[:, None] + shifts[None]).reshape(-1, 3)
    origin = nominal_gain_db(world.plan, world.orbit, np.zeros((1, 3)))
    gains = (nominal_gain_db(world.plan, world.orbit, pairs) - origin).reshape(6, 6, -1)
    curvature = (gains[:3, :3] - gains[:3, 3:] - gains[3:, :3] + gains[3:, 3:]) / (4.0 * step**2)
    single = nominal_gain_db(world.plan, world.orbit, shifts)
    return exact_response((single[:3] - single[3:]).T / (2.0 * step), np.moveaxis(curvature, 2, 0))


@pytest.fixture(scope="module")
def true_model():
    """Sixteen carriers of the simulator, their coefficients known without error."""
    return quadratic_of(World(scenario_named("white", operation_days=0.01), 1))


def noisy(model, rows, seed):
    """Attitudes within 0.3 deg and deviations with noise and 0.3 dB in common."""
    rng = np.random.default_rng(seed)
    attitude = rng.uniform(-0.3, 0.3, (rows, 3))
    noise = SIGMA_DB * rng.normal(size=(rows, len(model.slope))) + 0.3 * rng.normal(size=(rows, 1))
    return rng, attitude, predict_deviation(attitude, model) + noise


def solve(model, values, **options):
    carriers = values.shape[1]
    options = {"model_error_db": 1e-4, **options}
    return solve_snapshots(model, values, np.full(carriers, SIGMA_DB), subset_orders(carriers), **options)


def rms(errors):
    return np.sqrt(np.mean(np.square(errors), axis=0))


def test_snapshot_reaches_the_bound_with_true_coefficients(true_model):
    """Acceptance test 6: 3000 snapshots."""
    _, attitude, values = noisy(true_model, 3000, seed=61)
    fixes = solve(true_model, values)
    sigma = np.full(16, SIGMA_DB)
    bound = np.array([crlb_deg(predict_jacobian(a, true_model), sigma, with_common=True) for a in attitude])
    ratio = rms((fixes.attitude_deg - attitude) / bound)
    stated = rms((fixes.attitude_deg - attitude) / np.sqrt(np.diagonal(fixes.covariance_deg2, axis1=1, axis2=2)))
    print(f"seed 61: rms over bound {ratio}, over own sigma {stated}")
    # 3000 snapshots: one sigma of a ratio is 1 / sqrt(6000) = 0.013; goal 1.02 and twice that
    assert (ratio <= 1.046).all()
    assert (ratio >= 0.95).all()
    assert stated == pytest.approx(np.ones(3), abs=0.05)


@pytest.mark.parametrize("wrong", [0, 6, *(pytest.param(wrong, marks=pytest.mark.slow) for wrong in range(1, 6))])
def test_rain_on_some_uplinks_costs_little_more_than_to_an_oracle(true_model, wrong):
    """Acceptance test 7: one-sided fades of 0.5 to 6 dB on k of 16."""
    rng, attitude, values = noisy(true_model, 1000, seed=70 + wrong)
    is_wrong = np.argsort(rng.random(values.shape), axis=1) < wrong
    values = values - np.where(is_wrong, rng.uniform(0.5, 6.0, values.shape), 0.0)
    fixes = solve(true_model, values)
    oracle = solve(true_model, np.where(is_wrong, np.nan, values))
    errors = fixes.attitude_deg - attitude
    ratio = rms(errors) / rms(oracle.attitude_deg - attitude)
    excluded = fixes.use == CarrierUse.EXCLUDED
    false_share = excluded[~is_wrong].mean()
    missed = (~excluded[is_wrong]).mean() if wrong else 0.0
    far = (np.abs(errors[:, 1:]) > 0.3).any(axis=1).mean()
    print(
        f"k {wrong}, seed {70 + wrong}: rms {rms(errors)}, over oracle {ratio}, false {false_share:.4f}, "
        f"missed {missed:.4f}, beyond 0.3 deg {far:.4f}"
    )
    assert (ratio[1:] <= 1.4).all()
    assert false_share <= 0.003
    assert missed <= 0.005
    assert far < 0.01


@pytest.mark.parametrize(("carriers", "wrong", "plans"), [(8, 2, 8), (32, 14, 1)])
def test_steps_up_to_the_breakdown_of_other_sizes(true_model, carriers, wrong, plans):
    """Acceptance test 7 with 8 and 32 carriers chosen out of 40; eight carriers differ much from plan to plan."""
    bend = np.tile(true_model.curvature.mean(axis=0), (carriers, 1, 1))
    errors, oracles = [], []
    for seed in range(plans):
        stations = np.random.default_rng(seed).normal(0.0, [0.16, 1.4, 1.2], (40, 3))
        chosen = choose_carriers(stations, np.full(40, 0.1), np.arange(40), carriers)
        model = exact_response(stations[chosen], bend)
        rng, attitude, values = noisy(model, 500, seed=seed)
        is_wrong = np.argsort(rng.random(values.shape), axis=1) < wrong
        steps = rng.uniform(0.5, 6.0, values.shape) * rng.choice([-1.0, 1.0], values.shape)
        values = values + np.where(is_wrong, steps, 0.0)
        errors.append(solve(model, values).attitude_deg - attitude)
        oracles.append(solve(model, np.where(is_wrong, np.nan, values)).attitude_deg - attitude)
    ratio = rms(np.concatenate(errors)) / rms(np.concatenate(oracles))
    far = (np.abs(np.concatenate(errors)[:, 1:]) > 0.3).any(axis=1).mean()
    print(f"{wrong} of {carriers}, {plans} plans, seeds from 0: over oracle {ratio}, beyond 0.3 deg {far:.4f}")
    assert (ratio[1:] <= 1.4).all()
    assert far < 0.01


def test_a_transponder_of_six_that_moved_together(true_model):
    """Known as a group its carriers stay in the fix, which is then better than the oracle that drops them."""
    labels = np.array([0] * 6 + [1] * 5 + [2] * 5)
    rng, attitude, values = noisy(true_model, 800, seed=76)
    step = rng.uniform(0.5, 6.0, (800, 1)) * rng.choice([-1.0, 1.0], (800, 1))
    is_moved = np.tile(labels == 0, (800, 1))
    values = values + np.where(is_moved, step, 0.0)
    fixes = solve(true_model, values, group=labels)
    oracle = solve(true_model, np.where(is_moved, np.nan, values))
    errors = [rms(one.attitude_deg - attitude) for one in (fixes, oracle)]
    print(f"seed 76: group {errors[0]}, oracle without it {errors[1]}, found {(fixes.group == 0).mean():.3f}")
    assert (errors[0] <= 1.0 * errors[1]).all()
    assert (fixes.group == 0).mean() >= 0.99
    _, _, clean = noisy(true_model, 800, seed=77)
    assert (solve(true_model, clean, group=labels).group >= 0).mean() <= 0.002


@pytest.mark.slow
def test_yaw_scale_and_efficiency_with_a_fitted_calibration():
    """Acceptance test 4: eight seeds of `white`, 15-row snapshots, no attitude prior."""
    attitudes, errors, ratios, stated, excluded = [], [], [], [], []
    for seed in SLOPE_SEEDS:
        one = calibrated("white", seed)
        rng = np.random.default_rng(seed)
        attitude = rng.uniform(-0.3, 0.3, (1000, 3))
        sigma = one.white_db / np.sqrt(15.0)
        values = one.truth_db(attitude) + sigma * rng.normal(size=(1000, 16)) + 0.3 * rng.normal(size=(1000, 1))
        fixes = solve_snapshots(one.response, values, sigma, subset_orders(16))
        model = quadratic_of(one.world)
        bound = np.array([crlb_deg(predict_jacobian(a, model), sigma, with_common=True) for a in attitude])
        attitudes.append(attitude)
        errors.append(fixes.attitude_deg - attitude)
        ratios.append(errors[-1] / bound)
        stated.append(errors[-1] / np.sqrt(np.diagonal(fixes.covariance_deg2, axis1=1, axis2=2)))
        excluded.append((fixes.use == CarrierUse.EXCLUDED).mean())
    truth, error = np.concatenate(attitudes), np.concatenate(errors)
    slope = 1.0 + np.array([np.polyfit(truth[:, k], error[:, k], 1)[0] for k in range(3)])
    ratio, own = rms(np.concatenate(ratios)), rms(np.concatenate(stated))
    print(
        f"seeds {list(SLOPE_SEEDS)}: slope {slope}, rms over bound {ratio}, over own sigma {own}, "
        f"excluded {np.mean(excluded):.5f}"
    )
    # 8000 snapshots of 0.27 deg and 8 calibrations: one sigma of the yaw slope is 0.03
    assert slope[0] == pytest.approx(1.0, abs=0.10)
    assert slope[1:] == pytest.approx([1.0, 1.0], abs=0.03)
    assert (ratio <= 1.25).all(), "must; the goal is 1.10"
    assert own == pytest.approx(np.ones(3), abs=0.2)
    assert np.mean(excluded) <= 0.003


def test_calibration_predicts_levels_days_later():
    """Daily change by the dish law on day 4 against the simulator's dishes and orbit, noise-free."""
    one = calibrated("white", 3)
    file = export_arrays(one.world)
    epochs_us = file["epoch_us"][-140:]
    motion = motion_at(file, epochs_us, positions_of(one.world))
    level = predict_level_dbm(one.fit, one.geometry, motion, np.zeros(len(epochs_us)))
    deviation = file["power_dbm"][-140:] - level
    rows = one.world.rows
    deviation = deviation - one.truth_db(rows.attitude_deg[-140:])
    # what 140 rows of white noise leave in the mean of a carrier is 0.013 dB
    drift = deviation.mean(axis=0)
    residual_db = np.median(one.fit.residual_rms_db)
    print(f"seed 3: level error on day 4 {rms(drift):.4f} dB, residual of the fit {residual_db:.4f} dB")
    assert rms(drift) < 0.05


@pytest.mark.nightly
@pytest.mark.timeout(900)
def test_breakdown_over_many_rows(true_model):
    """Six of sixteen in 20000 rows, seven for the record."""
    for wrong, most in ((6, 0.002), (7, 1.0)):
        rng, attitude, values = noisy(true_model, 20_000, seed=700 + wrong)
        is_wrong = np.argsort(rng.random(values.shape), axis=1) < wrong
        values = values - np.where(is_wrong, rng.uniform(0.5, 6.0, values.shape), 0.0)
        chunks = [solve(true_model, chunk).attitude_deg for chunk in np.array_split(values, 40)]
        far = (np.abs(np.concatenate(chunks) - attitude)[:, 1:] > 0.3).any(axis=1).mean()
        print(f"{wrong} of 16, seed {700 + wrong}: beyond 0.3 deg in {far:.5f}")
        assert far <= most


SEEDS = (1, 2)
NIGHTLY_SEEDS = (1, 2, 3, 4, 5)
#: rms that must hold for the mean of the seeds, and the goal printed beside it
BOUNDS = {
    "white": ((0.10, 0.010, 0.015), "must .13/.025/.030, study .068/.013/.013"),
    "nominal": ((0.13, 0.018, 0.023), "must .13/.025/.030, goal .085/.015/.018"),
    "octants": ((0.13, 0.020, 0.025), "goal roll, pitch .020/.025"),
    "steps": ((0.13, 0.020, 0.023), "study .129/.029/.023"),
    "steps_heavy": ((0.15, 0.025, 0.030), "study .18/.038/.073, 352 min wrong"),
    "uplink_rain": ((0.13, 0.020, 0.023), "study .094/.019/.022"),
    "downlink_rain": ((0.13, 0.018, 0.023), "study .098/.017/.021"),
    "dual_band": ((0.13, 0.020, 0.025), "study .099/.019/.024"),
    "transponder": ((0.13, 0.020, 0.032), "study .114/.024/.031, 31 min wrong"),
    "mixed": ((0.14, 0.025, 0.030), "must .20/.06/.08, goal .11/.03/.035"),
    "gaps": ((0.14, 0.020, 0.028), "study .160/.031/.047"),
    "flicker": ((0.17, 0.045, 0.075), "goal .17/.045/.075"),
    "flicker_storm": ((0.18, 0.060, 0.075), "no wrong torque beyond 30 min"),
    "yaw_hold": ((0.16, 0.025, 0.030), "study's skill .36-.61/.91-.96/.72-.94"),
    "nominal_tau5": ((0.13, 0.035, 0.045), "roll, pitch .035/.045"),
    "nominal_tau120": ((0.15, 0.035, 0.045), "roll, pitch .035/.045"),
    "nominal_drift3": ((0.26, 0.035, 0.045), "roll, pitch .035/.045"),
    "nominal_uncoupled": ((0.15, 0.035, 0.045), "roll, pitch .035/.045"),
    "nominal_300s": ((0.13, 0.035, 0.045), "roll, pitch .035/.045"),
    "works": ((0.13, 0.020, 0.025), "declared work, no goal of its own"),
    "sun_outage": ((0.13, 0.020, 0.025), "declared, no goal of its own"),
    "demo": ((0.13, 0.020, 0.025), "no goal of its own"),
}
#: run at every change; the others every night
EVERY_TIME = ("white", "nominal", "mixed", "flicker", "yaw_hold", "nominal_drift3")
#: rms over sigma by axis; 1 = honest
HONEST = {"white": (0.6, 1.3)}
USUALLY_HONEST = (0.5, 1.5)
#: noise beyond what real links show raises protection levels to the alert limit
AVAILABLE = {"flicker": 0.84, "flicker_storm": 0.85}
FALSE_REPORTS = ("flipped", "halved", "lost", "doubled")
#: hours at which a slew that is not carried out as announced begins, and minutes for which it is judged
SLEWS_H, SLEW_MINUTES = (9, 30), 240


def campaign(robust_world, name, seeds):
    """Return the figures of a scenario by seed; they are printed too."""
    figures = [robust_world.RobustWorld(scenario_named(name), seed).drive().judged() for seed in seeds]
    with np.printoptions(precision=3, suppress=True):
        for seed, row in zip(seeds, figures, strict=True):
            print(f"{name} seed {seed}:", ", ".join(f"{key} {value}" for key, value in row.items()))
        print(f"{name} mean rms {np.mean([row['rms'] for row in figures], axis=0)} ({BOUNDS[name][1]})")
    return figures


def assert_bounds(name, figures):
    # bounds are for the mean of five seeds; one alone scatters by a quarter
    room = 1.25 if len(figures) == 1 else 1.0
    assert (np.mean([row["rms"] for row in figures], axis=0) <= room * np.array(BOUNDS[name][0])).all()
    ratio = np.mean([row["ratio"] for row in figures], axis=0)
    wrong_yaw = [row["wrong_yaw"] for row in figures]
    allowed = np.mean([row["yaw_available"] for row in figures])
    print(f"{name} mean rms/sigma {ratio.round(2)}, yaw wrong {wrong_yaw} min, allowed {allowed:.2f}")
    low, high = HONEST.get(name, USUALLY_HONEST)
    assert (ratio < high).all(), "sigma must be honest"
    assert (ratio > low).all()
    assert np.mean([row["available"] for row in figures]) >= AVAILABLE.get(name, 0.98)
    assert sum(row["wrong_roll_pitch"] for row in figures) == 0
    # the must of mixed is 60 min; a yaw turn that nobody announced takes its time to be seen
    assert np.mean(wrong_yaw) <= {"flicker": 10, "yaw_hold": 100}.get(name, 60)


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY_TIME)
def test_scenarios_meet_their_bounds(name):
    """Seed 2; five seeds of every scenario in the nightly run."""
    assert_bounds(name, campaign(robust_world, name, SEEDS[1:]))


@pytest.mark.nightly
@pytest.mark.parametrize("name", BOUNDS)
def test_scenarios_meet_their_bounds_over_five_seeds(name):
    assert_bounds(name, campaign(robust_world, name, NIGHTLY_SEEDS))


def assert_false_reports_are_survived(robust_world, fault, seed):
    """No wrong torque is allowed; roll and pitch stay near the truth around both slews.

    The goal of 0.10 deg holds but on seed 5 of `flipped`, where pitch is 0.12 off before the doubt is sure.
    """
    reported = robust_world.RobustWorld(scenario_named(f"corrections_{fault}"), seed).drive()
    error_deg = np.abs(reported.estimate_deg - reported.truth_deg)
    doubted = np.array([row.state.watch["doubted_minutes"][0] > 0.0 for row in reported.steps])
    for hour in SLEWS_H:
        slew = slice(60 * hour, 60 * hour + SLEW_MINUTES)
        found = f"after {np.argmax(doubted[slew])} min" if doubted[slew].any() else "never"
        print(f"{fault} seed {seed} at {hour} h: largest error {error_deg[slew].max(axis=0).round(3)}, doubted {found}")
        assert error_deg[slew, 1:].max() <= (0.13 if fault == "flipped" else 0.10)
    assert reported.judged()["wrong_roll_pitch"] == 0
    # what is not found is followed by the powers within the bound; the other sign is always found
    assert fault != "flipped" or doubted.any()


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["flipped", "lost"])
def test_commands_that_are_not_carried_out_do_no_harm(fault):
    assert_false_reports_are_survived(robust_world, fault, SEEDS[1])


@pytest.mark.nightly
@pytest.mark.parametrize("seed", NIGHTLY_SEEDS)
@pytest.mark.parametrize("fault", FALSE_REPORTS)
def test_commands_that_are_not_carried_out_do_no_harm_over_five_seeds(fault, seed):
    assert_false_reports_are_survived(robust_world, fault, seed)


@pytest.mark.slow
def test_a_declared_eclipse_stops_nothing_and_turns_little():
    """Two nights of `eclipse`: control goes on, roll and pitch move by little more than the reflector bends."""
    world = robust_world.RobustWorld(scenario_named("eclipse"), SEEDS[1])
    reported = world.drive()
    epochs_us = np.array([row.state.epoch_us for row in reported.steps])
    error_deg = reported.estimate_deg - reported.truth_deg
    eclipses = [operation for operation in world.world.operations if operation.kind == "eclipse"]
    assert eclipses
    for operation in eclipses:
        begin, end = np.searchsorted(epochs_us, [operation.start_us, operation.stop_us])
        stopped = int((~reported.is_allowed[begin : end + 60, 1]).sum())
        moved_deg = np.abs(error_deg[begin : end + 60] - error_deg[begin]).max(axis=0)
        left_deg = np.abs(error_deg[end + 180] - error_deg[begin])
        print(f"eclipse: control off {stopped} min, moved {moved_deg.round(3)}, 3 h later {left_deg.round(3)}")
        assert stopped <= 30
        # the reflector bends by 0.02-0.05 deg, which no power tells from an attitude; the filter's own noise is 0.02
        assert (moved_deg[1:] <= 0.06).all()
        assert (left_deg[1:] <= 0.05).all()


@pytest.mark.slow
def test_innovations_have_the_variance_they_are_given():
    """Normalised innovation squared of `white` inside its 95 % band."""
    reported = robust_world.RobustWorld(scenario_named("white"), SEEDS[0]).drive()
    ratio = float(reported.nis[60:].mean())
    # 2820 rows of 16 carriers: sqrt(2 / 45120) twice, and the running mean of an hour at both ends
    band = 1.96 * np.sqrt(2.0 / (reported.nis[60:].size * reported.is_used.shape[1]))
    print(f"white seed {SEEDS[0]}: normalised innovation squared {ratio:.4f}, band 1 +- {band:.4f}")
    assert abs(ratio - 1.0) <= band


@pytest.mark.slow
def test_a_filter_without_the_coupling_loses_yaw():
    """The bound on yaw cannot be met without dynamics: the figure means something."""
    world = robust_world.RobustWorld(scenario_named("octants"), 1)
    without = world.drive(FilterSettings(coupling_per_h=0.0)).judged()
    print(f"octants seed 1 without coupling: rms {without['rms']}")
    assert without["rms"][0] > BOUNDS["octants"][0][0]


LIAR_SEED = 1
LIE_BEGIN_H = 2.0
LIE_DB_H = 0.06
#: carriers that creep away by 1 mdB/min from the third hour of a day on: signs by carrier, and the greatest errors of
#: yaw, and of roll and pitch, that they may make, deg
LIES = {
    "one": ([{k: 1.0} for k in range(16)], 0.30, 0.12),
    "three of one sign": ([{0: 1.0, 9: 1.0, 12: 1.0}, {0: 1.0, 4: 1.0, 13: 1.0}], 0.45, 0.20),
    "three of both signs": ([{0: 1.0, 9: -1.0, 12: 1.0}], 0.40, 0.15),
    "all": ([dict.fromkeys(range(16), 1.0)], 0.10, 0.05),
}


@pytest.mark.nightly
@pytest.mark.parametrize("lie", LIES)
def test_creeping_carriers_lead_no_farther_than_before(lie):
    liars, most_yaw_deg, most_deg = LIES[lie]
    world = shared_world("nominal", LIAR_SEED, 1.0)
    plain = world.plain
    creep_db = LIE_DB_H * np.maximum(world.hours - LIE_BEGIN_H, 0.0)
    worst = np.zeros(3)
    for signs in liars:
        power_dbm = world.ground.power_dbm.copy()
        for carrier, sign in signs.items():
            power_dbm[:, carrier] += sign * creep_db
        flown = world.fly(power_dbm)
        # noise is that of the plain flight: what is left is made by the liars
        led_deg = np.abs(flown.estimate_deg - plain.estimate_deg)[flown.is_allowed].max(axis=0)
        error_deg = np.abs(flown.error_deg[flown.is_allowed]).max(axis=0)
        allowed, minutes = flown.is_allowed.mean(), flown.wrong_minutes
        print(f"{lie} {sorted(signs)}: led {led_deg.round(3)}, error {error_deg.round(3)} deg, ", end="")
        print(f"allowed {allowed:.3f}, wrong {minutes} min, seed {LIAR_SEED}")
        worst = np.maximum(worst, led_deg)
    assert worst[0] < most_yaw_deg
    assert worst[1:].max() < most_deg
