"""Figures of the observability: torque, carriers, bounds of a measured motion and planned sigma."""

from pathlib import Path
from tempfile import TemporaryDirectory

import filter_models
import numpy as np
import pytest
from filter_rows import step
from kept_results import kept
from plan_files import write_plan_files

from analyzer_sim.world.orbit import Orbit
from analyzer_sim.world.payload.carriers import PLANS
from analyzer_sim.world.payload.level_terms import sensitivity_db_per_deg
from service.cli.planning.sources import PlanFiles, PlanRequest, planned_by_files
from service.core.estimation.attitude_bound import DriftStatistics, WheelStatistics, attitude_bound_deg
from service.core.estimation.calibration.whitened_fit import ColouredNoise
from service.core.estimation.design import choose_carriers, largest_share, most_share, weighted_variance_deg2
from service.core.estimation.filtering.filter_model import (
    FedForward,
    FilterSettings,
    PolarimeterModel,
    core_size,
    initial_gaussian,
    no_motion,
)
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.plant import filter_model, is_pushed, torque_covariance
from service.core.estimation.filtering.state_changes import inserted
from service.core.estimation.observability import averaged_crlb_deg, judge_set
from service.core.estimation.paper.selection import select_by_axis
from service.pipeline.inputs.knowledge import JournalDocuments
from service.pipeline.planning.assumed_beams import NOISES
from service.pipeline.planning.planning import Rule, candidates_of, recommend
from service.study.estimation.bounds import measure_accuracy
from service.study.estimation.flight.drive import calibrate, drive
from service.study.estimation.flight.world import simulated_world

SEED = 61
REALISATIONS = 12
#: noise of one row, dB
SIGMA_DB = 0.1857
#: carriers: condition, bound without and with a common level (yaw, roll, pitch), dilution, angle dilution
PUBLISHED = {
    8: (30.0, (1.34, 0.056, 0.182), (1.46, 0.061, 0.209), (7.2, 0.30, 0.98), 0.79),
    16: (34.0, (0.97, 0.039, 0.130), (1.01, 0.044, 0.144), (5.3, 0.21, 0.70), 0.58),
    32: (37.0, (0.75, 0.031, 0.097), (0.77, 0.035, 0.108), (4.0, 0.17, 0.52), 0.42),
}


@pytest.fixture(scope="module")
def stations():
    """True sensitivities (40, 3) of all users of both bands, and the number of each one's transponder."""
    still = Orbit(90.0, 1_700_000_000_000_000, 0.0, 0.0, 0.0, 0.0, 0.0)
    ku, mixed = PLANS["ku32"], PLANS["kuc16"]
    sensitivity = np.vstack([sensitivity_db_per_deg(ku, still), sensitivity_db_per_deg(mixed, still)[8:]])
    names = [carrier.transponder for carrier in (*ku.carriers, *mixed.carriers[8:])]
    return sensitivity, np.unique(names, return_inverse=True)[1]


def drawn(stations, count, rng):
    """Return sensitivities of so many Ku users, as many from each of the four transponders."""
    sensitivity, transponder = stations
    ku = np.unique(transponder[:32])
    chosen = [rng.choice(np.flatnonzero(transponder == label), count // len(ku), replace=False) for label in ku]
    # beams differ from craft to craft: slopes are drawn again by a tenth of their size
    rows = sensitivity[np.concatenate(chosen)]
    return rows * rng.normal(1.0, 0.1, rows.shape)


@pytest.mark.parametrize("count", [8, 16, 32])
def test_medians_are_those_of_the_published_table(stations, count):
    rng = np.random.default_rng(SEED + count)
    found = [judge_set(drawn(stations, count, rng), np.full(count, SIGMA_DB)) for _ in range(REALISATIONS)]
    condition, alone, common, dilution, angle = PUBLISHED[count]
    medians = {
        name: np.median([getattr(figures, name) for figures in found], axis=0)
        for name in found[0]._fields
        if name not in {"leverage", "undetectable_fault_db", "fault_shift_deg"}
    }
    print(f"seed {SEED + count}: {medians}")
    # another payload and twelve draws of it: each figure within two fifths
    assert medians["condition"] == pytest.approx(condition, rel=0.4)
    assert medians["crlb_without_common_deg"] == pytest.approx(np.array(alone), rel=0.4)
    assert medians["crlb_deg"] == pytest.approx(np.array(common), rel=0.4)
    assert medians["dop_deg_per_db"] == pytest.approx(np.array(dilution), rel=0.4)
    assert medians["angle_dop_deg_per_db"] == pytest.approx(angle, rel=0.4)
    # relations that hold for any payload: 0.1857 dB of dilution is the bound, yaw is weak, a common level is cheap
    assert medians["crlb_without_common_deg"] == pytest.approx(SIGMA_DB * medians["dop_deg_per_db"], rel=1e-9)
    ratio = medians["crlb_deg"][0] / medians["crlb_deg"][1:]
    assert 15.0 < ratio[0] < 31.0
    assert 4.5 < ratio[1] < 9.5
    assert (medians["crlb_deg"] < 1.45 * medians["crlb_without_common_deg"]).all()
    assert 0.2 < medians["common_share"] < 0.8, "all of one sign does not separate rain from a turn"


def test_yaw_and_pitch_look_nearly_the_same(stations):
    """Correlation of the estimates -0.96 in the publication's payload."""
    rng, found = np.random.default_rng(SEED), []
    for _ in range(REALISATIONS):
        design = np.column_stack([drawn(stations, 16, rng), np.ones(16)])
        covariance = np.linalg.inv(design.T @ design)
        found.append(covariance[0, 2] / np.sqrt(covariance[0, 0] * covariance[2, 2]))
    print(f"seed {SEED}: {np.round(found, 3)}")
    assert -0.995 < np.median(found) < -0.85


def test_a_fade_without_a_common_unknown_looks_like_a_turn(stations):
    """1 dB of rain on all carriers; the publication's payload gives 3.5 / 0.27 / -0.81 deg."""
    rng, found = np.random.default_rng(SEED), []
    for _ in range(REALISATIONS):
        sensitivity = drawn(stations, 16, rng)
        found.append(np.abs(np.linalg.lstsq(sensitivity, -np.ones(16), rcond=None)[0]))
    median = np.median(found, axis=0)
    print(f"seed {SEED}: {median}")
    # another payload: same size, within a factor of three
    assert (median > np.array([3.5, 0.27, 0.81]) / 3.0).all()
    assert (median < np.array([3.5, 0.27, 0.81]) * 3.0).all()


def test_averages_of_the_published_noise(stations):
    """White 0.155 dB and 0.09 dB of 20 min with the bound 1.01 / 0.044 / 0.144 of one row at 0.1857 dB."""
    span_s = np.array([900.0, 3600.0, 14_400.0, 43_200.0])
    noise = ColouredNoise(np.full(16, 0.155), np.full((16, 1), 0.09), np.full((16, 1), 1200.0))
    sensitivity = drawn(stations, 16, np.random.default_rng(SEED))
    one_row = judge_set(sensitivity, np.full(16, SIGMA_DB)).crlb_deg
    reported = averaged_crlb_deg(sensitivity, noise, span_s, 60.0) / one_row
    published = np.array([[0.46, 0.021, 0.066], [0.33, 0.015, 0.047], [0.19, 0.008, 0.027], [0.11, 0.005, 0.016]])
    # the printed figures have one or two digits: 0.005 is good to ten per cent
    assert reported == pytest.approx(published / np.array([1.01, 0.044, 0.144]), rel=0.13)


def test_assumed_noise_of_links_has_the_measured_correlation():
    """284 measured links: spread 0.24 dB in a day; autocorrelation 0.75 / 0.56 / 0.43 / 0.29 / 0.06."""
    noise = NOISES["links"]
    total = noise.white_db**2 + sum(sigma**2 for _, sigma in noise.parts)
    assert np.sqrt(total) == pytest.approx(0.24, abs=0.01)  # printed to two digits
    for lag_s, measured in ((60, 0.75), (900, 0.56), (3600, 0.43), (10_800, 0.29), (43_200, 0.06)):
        kept = sum(sigma**2 * np.exp(-lag_s / tau_s) for tau_s, sigma in noise.parts) / total
        assert kept == pytest.approx(measured, abs=0.03), lag_s


@pytest.mark.parametrize("count", [8, 16])
def test_choice_out_of_forty_stations(stations, count):
    """The paper's rule costs 15 to 40 % in sigma against the optimal choice, chance 1.4 to 3 times."""
    sensitivity, transponder = stations
    sigma, rng = np.full(40, SIGMA_DB), np.random.default_rng(SEED)
    best = choose_carriers(sensitivity, sigma, transponder, count)
    optimal = judge_set(sensitivity[best], sigma[best])
    chosen = select_by_axis(sensitivity, np.ones(40, dtype=bool), count).chosen
    paper = judge_set(sensitivity[chosen], sigma[chosen]).crlb_deg
    draws = [rng.choice(40, count, replace=False) for _ in range(400)]
    chance = np.median([judge_set(sensitivity[draw], sigma[draw]).crlb_deg for draw in draws], axis=0)
    print(
        f"{count}: optimal {optimal.crlb_deg}, paper over it {paper / optimal.crlb_deg}, "
        f"random over it {chance / optimal.crlb_deg}, seed {SEED}"
    )
    assert len(best) == count
    # 35 %, or what three transponders hold of so many carriers: 3 of 8 is 37.5 %
    assert largest_share(transponder[best]) <= most_share(count)
    ratio = np.sqrt(weighted_variance_deg2(paper) / weighted_variance_deg2(optimal.crlb_deg))
    assert 1.1 < ratio < 1.45
    assert (chance / optimal.crlb_deg > 1.3).all()
    assert (chance / optimal.crlb_deg < 3.4).all()


@pytest.mark.slow
def test_calibration_by_geometry_states_an_honest_bound(stations):
    """32 users of `many32`: bounds by fitted coefficients against those by the true ones, and the sets side by side."""
    ground = simulated_world("many32", 1, 0.2).ground
    documents = JournalDocuments()
    documents.add_plan(ground.carriers)
    documents.add_ephemeris(ground.ephemeris)
    plan = documents.plans[1]
    calibration = calibrate(ground, plan, documents.ephemerides[1])
    assert calibration.result is not None
    found = recommend(candidates_of(calibration.result, plan), 16, Rule.OPTIMAL)
    true = stations[0][:32]
    error = np.sqrt(np.mean((found.candidates.sensitivity_db_per_deg - true) ** 2, axis=0))
    bounds = {name: one.figures.crlb_deg for name, one in found.sets.items()}
    honest = {
        name: judge_set(true[one.chosen], found.candidates.sigma_db[one.chosen]).crlb_deg
        for name, one in found.sets.items()
    }
    print(f"errors of coefficients {error}, bounds {bounds}, with the true coefficients {honest}")
    # ten times less than freely fitted ones (0.14) in yaw
    assert error[0] < 0.03
    for name, bound in bounds.items():
        # roll and pitch coefficients of 1.3 dB/deg are off by 0.07: a tenth of a bound at most
        assert bound == pytest.approx(honest[name], rel=0.1)
    optimal, paper, everything = (bounds[name] for name in ("optimal", "paper", "all"))
    # section 3 of the comparison: 15 to 40 per cent in sigma, here somewhat more
    assert (paper / optimal > 1.15).all()
    assert (paper / optimal < 1.65).all()
    assert (optimal / everything < 1.2).all(), "half of the carriers, well chosen, see nearly as much as all"
    # the simulator's users: white 0.155 dB and 0.09 dB of 20 min in the mean; what the calibration learned of them
    # gives the same average of an hour to a quarter
    hour = np.array(found.sets[found.rule].averaged_deg[1])
    kept = averaged_crlb_deg(
        true[found.sets[found.rule].chosen],
        ColouredNoise(np.full(16, 0.155), np.full((16, 1), 0.09), np.full((16, 1), 1200.0)),
        np.array([3600.0]),
        60.0,
    )[0]
    print(f"average of an hour {hour}, with the noise that was made {kept}")
    assert hour == pytest.approx(kept, rel=0.25)


STEP_US = 600_000_000
CARRIERS = 16
SIZE = np.array([0.143, 0.143, 0.265])
PUSHED = FilterSettings(torque_deg_h2=tuple(SIZE))
HOURS = (6, 12, 24, 48)


@pytest.fixture(scope="module")
def model():
    """Carriers of the usual sizes: white .15 of a row, .08 of 20 min, .02 of 2 h, .013 of 10 h, walk .003 dB/sqrt h.

    Stations of one country: yaw moves them by an eighth of what pitch does, and in nearly the same direction.
    """
    plain = filter_models.carrier_model(carriers=CARRIERS, components=3)
    rng = np.random.default_rng(3)
    azimuth, elevation = np.radians(rng.uniform([-5.2, 6.3], [5.0, 8.5], (CARRIERS, 2)).T)
    _, roll, pitch = plain.gradient_db_deg.T
    return plain._replace(
        gradient_db_deg=np.column_stack([elevation * pitch - azimuth * roll, roll, pitch]),
        white_sigma_db=np.full(CARRIERS, 0.15 / np.sqrt(10.0)),
        coloured_sigma_db=np.tile([0.08, 0.02, 0.013], (CARRIERS, 1)),
        reference_walk_db=np.full(CARRIERS, 0.003),
    )


def sigmas(model, settings, known=()):
    """Return sigma of the angles (H, 3), deg, and of the torque (H, 3) as a share of its size, after some hours."""
    prior = torque_covariance(settings)
    for axis in known:
        prior[axis::3] *= 1e-3
        prior[:, axis::3] *= 1e-3
    aligned, references = np.array([0.004, 0.002, 0.002]), np.full(CARRIERS, 0.03)
    gaussian = initial_gaussian(model, np.zeros(3), aligned, references, drift_deg_h=settings.drift_deg_h)
    if is_pushed(settings):
        gaussian = inserted(gaussian, core_size(model), prior)
    state, compiled = start(model, 0, gaussian), filter_model(model, settings)
    angles, torques = [], []
    for row in range(1, 6 * max(HOURS) + 1):
        found = step(compiled, state, row * STEP_US, np.zeros(CARRIERS), no_motion())
        # rows without noise teach nothing about it
        state = found.state.with_carriers(white_scale=1.0).with_watch(slow_scale=1.0)
        if row % 6 == 0 and row // 6 in HOURS:
            angles.append(np.sqrt(np.diag(state.covariance)[:3]))
            torques.append(_torque_sigma(model, state, row) / SIZE if is_pushed(settings) else np.zeros(3))
    return np.array(angles), np.array(torques)


def _torque_sigma(model, state, rows):
    phase = 2.0 * np.pi * rows / 144.0
    now = np.kron([1.0, np.cos(phase), np.sin(phase)], np.eye(3))
    first = core_size(model)
    return np.sqrt(np.diag(now @ state.covariance[first : first + 9, first : first + 9] @ now.T))


def test_a_torque_is_learned_within_a_day_and_yaw_is_what_it_costs(model):
    angles, torques = sigmas(model, PUSHED)
    print("angles", angles.round(3).tolist(), "torque", torques.round(3).tolist())
    assert (torques[0] < [0.7, 0.3, 0.15]).all()
    # half of the torque is constant: until noon a constant and a wave look alike
    assert (torques[1] < [0.5, 0.3, 0.1]).all()
    assert (torques[2] < [0.12, 0.1, 0.05]).all()
    assert (angles[:, 1] < 0.02).all()
    assert (angles[:, 2] < 0.06).all()
    # yaw is not known to the tenth of a degree that it is known to without the torque
    assert (angles[:3, 0] > 0.2).all()
    assert (angles[:, 0] < 0.4).all()


def test_without_a_torque_yaw_is_known(model):
    angles, _ = sigmas(model, FilterSettings())
    print("angles", angles.round(3).tolist())
    assert (angles[:, 0] < 0.125).all()


def test_what_limits_yaw_is_the_torque_about_roll(model):
    """A wave about roll looks as a wave of yaw does for half a day; were it known, yaw would be."""
    free, _ = sigmas(model, PUSHED)
    roll_known, _ = sigmas(model, PUSHED, known=(1,))
    pitch_known, _ = sigmas(model, PUSHED, known=(2,))
    print("roll", roll_known[:, 0].round(3).tolist(), "pitch", pitch_known[:, 0].round(3).tolist())
    assert (roll_known[:3, 0] < [0.45, 0.55, 0.8] * free[:3, 0]).all()
    assert (pitch_known[:, 0] > 0.8 * free[:, 0]).all()


def test_even_a_tenth_of_the_torque_leaves_yaw_unknown(model):
    weak, _ = sigmas(model, FilterSettings(torque_deg_h2=tuple(0.1 * SIZE)))
    print("angles", weak.round(3).tolist())
    assert (weak[:, 0] > 0.15).all()


def fed_forward(relative_error, axis_relative_error, phase=0.0):
    """Return a profile of 7.6, 12.9 and 6.8e-6 N m, roll and pitch a quarter of a wave apart."""
    size = np.array([7.6, 12.9, 6.8]) / 0.5 * SIZE
    phases = phase + np.array([1.0, 0.0, 0.5 * np.pi])
    cosine, sine = (tuple((size * part).tolist()) for part in (np.cos(phases), -np.sin(phases)))
    reported = FedForward((0.0, 0.0, 0.0), cosine, sine, relative_error, axis_relative_error, 86_400_000_000)
    return FilterSettings(fed_forward=reported)


#: where roll's wave is zero at the alignment, and where it is at its crest
ZERO, CREST = 0.5 * np.pi, 0.0


def test_where_the_profile_is_known_yaw_is(model):
    """Six per cent of 12.9e-6 N m are more than the 5e-7 of unknown shape, and yaw is known nearly twice as well."""
    free, _ = sigmas(model, PUSHED)
    crest, _ = sigmas(model, fed_forward(0.06, 0.01, CREST))
    zero, _ = sigmas(model, fed_forward(0.06, 0.01, ZERO))
    print("crest", crest[:, 0].round(3).tolist(), "zero", zero[:, 0].round(3).tolist())
    assert (crest[:, 0] < 0.6 * free[:, 0]).all()
    assert (crest[:, 0] < 0.17).all()
    # where roll's wave begins at zero the first half day tells its own share late
    assert (zero[:, 0] < 0.85 * free[:, 0]).all()
    assert (zero[2:, 0] < 0.16).all()


def test_what_pitch_tells_of_the_others_counts_where_roll_begins_at_zero(model):
    """The negative control: a share of each axis' own; at the crest the known shape does all of it."""
    for phase, ratio in ((CREST, (1.0, 1.1)), (ZERO, (1.15, 2.0))):
        shared, _ = sigmas(model, fed_forward(0.06, 0.01, phase))
        own, _ = sigmas(model, fed_forward(0.0, 0.06, phase))
        print("own", own[:, 0].round(3).tolist())
        assert ratio[0] < (own[:2, 0] / shared[:2, 0]).max() < ratio[1]


#: white noise and a part of twenty minutes
NOISE = ColouredNoise(np.full(16, 0.1), np.full((16, 1), 0.1), np.full((16, 1), 1200.0))
#: towards the receiving site, by yaw, roll, pitch
SIGHT = (0.99, -0.09, -0.13)
#: what measures motion, and the study's yaw, roll and pitch, deg
CASES = {
    "powers": ({}, (0.0955, 0.0138, 0.0207)),
    "wheels": ({"wheels": WheelStatistics(8.0)}, (0.046, 0.0120, 0.0175)),
    "rates three times as good as the drift": (
        {"drift": DriftStatistics((0.04 / 3, 0.025 / 3, 0.025 / 3))},
        (0.035, 0.0118, 0.0142),
    ),
    "rates ten times as good": ({"drift": DriftStatistics((0.004, 0.0025, 0.0025))}, (0.015, 0.0095, 0.0105)),
    "polarisation, ordinary": ({"polarimeters": (PolarimeterModel(SIGHT),)}, (0.057, 0.0137, 0.0181)),
}
TOLERANCE = 0.15


@pytest.fixture(scope="module")
def sensitivity():
    return sensitivity_db_per_deg(PLANS["ku16"], Orbit(90.0, 1_700_000_000_000_000, 0.0, 0.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("case", CASES)
def test_the_bound_is_that_of_the_study(case, sensitivity):
    measured, expected_deg = CASES[case]
    bound_deg = attitude_bound_deg(sensitivity, NOISE, **measured)
    print(f"{case}: {bound_deg.round(4)} deg, study {expected_deg}")
    np.testing.assert_allclose(bound_deg, expected_deg, rtol=TOLERANCE)


def test_a_sensor_of_a_hundredth_of_a_degree_an_hour_has_the_yaw_that_the_filter_reaches(sensitivity):
    # ten worlds `rates`: 0.043/0.0116/0.0125 deg rms; the yaw of 0.035 of the study is not reproduced
    sensor = DriftStatistics((0.01, 0.01, 0.01), walk_deg_sqrt_h=0.003)
    bound_deg = attitude_bound_deg(sensitivity, NOISE, drift=sensor)
    print(f"rates of 0.01 deg/h: {bound_deg.round(4)} deg")
    np.testing.assert_allclose(bound_deg, (0.043, 0.0118, 0.0142), rtol=TOLERANCE)


AXES = ("yaw", "roll", "pitch")
SEEDS = {"nominal": range(1, 6), "octants": range(1, 6), "weather_far": range(1, 6)}
SETTLING_US = 3_600_000_000
FACTOR = 1.5


def predicted_and_reached(scenario, seed):
    """Return sigma before the turns, the one-row bound with assumed noise, and rms after them (3,), deg."""
    world = simulated_world(scenario, seed)
    with TemporaryDirectory() as folder:
        path = Path(folder)
        options = write_plan_files(world, path)
        files = {
            name[2:].removesuffix("-file"): Path(file) for name, file in zip(options[::2], options[1::2], strict=True)
        }
        request = PlanRequest(None, "optimal", far_yaw=False)
        quiet = planned_by_files(PlanFiles(**files), [], "links", request).document["quiet"]
        assumed = PlanFiles(files["spacecraft"], files["carriers"], files["contours"])
        bound = planned_by_files(assumed, [], "links", request).document["sets"]["all"]["crlb_deg"]
    driven = drive(world.ground)
    robust = driven.methods["robust"]
    settled = world.ground.epochs_us[driven.rows] >= world.ground.phases["operation"].start_us + SETTLING_US
    truth_deg = world.truth.attitude_deg[driven.rows[settled]]
    accuracy = measure_accuracy(robust.estimate_deg[settled], robust.sigma_deg[settled], truth_deg)
    sigma_deg, bound_deg = (np.array([angles[axis] for axis in AXES]) for angles in (quiet["sigma_deg"], bound))
    return sigma_deg, bound_deg, np.sqrt(accuracy.mean_square_error)


def means(scenario):
    every = np.array([kept(predicted_and_reached, scenario, seed) for seed in SEEDS[scenario]])
    for seed, (sigma, _, rms) in zip(SEEDS[scenario], every, strict=True):
        print(f"{scenario} seed {seed}: predicted {sigma.round(3)}, reached {rms.round(3)}, {np.round(rms / sigma, 2)}")
    sigma, bound, rms = every.mean(axis=0)
    ratio = np.round(rms / sigma, 2)
    print(f"{scenario}: predicted {sigma.round(3)}, reached {rms.round(3)}, reached over predicted {ratio}")
    return sigma, bound, rms


def is_near(predicted, reached):
    return (np.abs(np.log(reached / predicted)) <= np.log(FACTOR)).all()


@pytest.mark.nightly
@pytest.mark.timeout(3000)  # fifteen flights of two days
def test_sigma_before_the_turns_is_the_error_after_them():
    found = {scenario: means(scenario) for scenario in SEEDS}
    for sigma, bound, rms in found.values():
        assert is_near(sigma, rms)
        assert not is_near(bound, rms), "the bound of one row with assumed noise is no prediction"
    # the weather of the links is seen: what holds in the dry does not hold there
    assert not is_near(found["nominal"][0], found["weather_far"][2])


@pytest.mark.slow
@pytest.mark.nightly
def test_sigma_before_the_turns_of_one_world():
    sigma, _, rms = kept(predicted_and_reached, "nominal", 1)
    print(f"nominal, seed 1: predicted {sigma.round(3)}, reached {rms.round(3)}")
    assert is_near(sigma, rms)
