"""Signals: orbit and antenna frame, beams and dishes, repeaters, noise, polarimeter, structure of the plan."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from simulated_gain import attitude_gain_db

from analyzer_sim.epochs import US_PER_DAY
from analyzer_sim.streams import daily_wave, first_order, stream
from analyzer_sim.world.orbit import (
    EARTH_RATE_RAD_S,
    GEO_RADIUS_KM,
    Orbit,
    antenna_angles_deg,
    antenna_frame_deg,
    body_from_orbital,
    dish_motion_deg,
    orbital_from_earth,
    predicted_track,
    station_position_km,
)
from analyzer_sim.world.payload.carriers import PLANS, Beam, Ripple
from analyzer_sim.world.payload.effects import FaultFlag
from analyzer_sim.world.payload.level_terms import (
    dish_loss_db,
    dishes_loss_db,
    level_control_db,
    mispointing_deg,
    nominal_gain_db,
    power_control_db,
    sensitivity_db_per_deg,
)
from analyzer_sim.world.polarimeter import body_turn_deg
from analyzer_sim.world.scenario.events import DownlinkRain, Step, SwitchOff, UplinkRain
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.scenario.story import RepeaterSettings, Scenario
from analyzer_sim.world.structure import crlb_deg, report, structure_of
from analyzer_sim.world.world import World

SATELLITE_KM = np.array([[0.0, GEO_RADIUS_KM, 0.0]])  # 90 deg East
NORMAL = np.array([[0.0, 0.0, 1.0]])
MOSCOW_KM = station_position_km(55.75, 37.62)[None, :]


def displaced_deg(yaw: float, roll: float, pitch: float, station_km: np.ndarray = MOSCOW_KM) -> tuple[float, float]:
    """Return how a station moves in the antenna frame."""
    orbital = orbital_from_earth(SATELLITE_KM, NORMAL)
    az0, el0 = antenna_frame_deg(orbital, SATELLITE_KM, station_km)
    turned = body_from_orbital(np.array([[yaw, roll, pitch]])) @ orbital
    az, el = antenna_frame_deg(turned, SATELLITE_KM, station_km)
    return float((az - az0)[0, 0]), float((el - el0)[0, 0])


def test_russia_lies_north_and_moscow_west_of_the_nadir_from_90_east() -> None:
    az, el = antenna_frame_deg(orbital_from_earth(SATELLITE_KM, NORMAL), SATELLITE_KM, MOSCOW_KM)
    # figures of the geometry to two decimals: -4.08 and 7.48 deg
    assert az[0, 0] == pytest.approx(-4.08, abs=0.01)
    assert el[0, 0] == pytest.approx(7.48, abs=0.01)


@pytest.mark.parametrize(
    ("attitude", "expected"),
    [
        ((0.0, 0.1, 0.0), (0.0, -0.1)),  # +roll moves a station South
        ((0.0, 0.0, 0.1), (-0.1, 0.0)),  # +pitch moves it West
        ((0.1, 0.0, 0.0), (-0.1 * np.radians(7.48), 0.1 * np.radians(-4.08))),  # yaw: -yaw el, +yaw az
    ],
)
def test_small_turns_follow_the_signs(attitude: tuple[float, float, float], expected: tuple[float, float]) -> None:
    # 2 % of 0.1 deg: the first-order formulas are 1 % short at 8 deg from nadir
    assert displaced_deg(*attitude) == pytest.approx(expected, abs=0.002)


def test_exact_turns_agree_with_the_better_formulas_to_second_order() -> None:
    yaw, roll, pitch = 0.3, -0.2, 0.25
    az, el = (
        np.radians(a[0, 0])
        for a in antenna_frame_deg(orbital_from_earth(SATELLITE_KM, NORMAL), SATELLITE_KM, MOSCOW_KM)
    )
    ta, te = np.tan(az), np.tan(el)
    daz = -pitch * 1.0 - (yaw * te + roll * ta * te) * np.cos(az) ** 2
    d_el = -roll + (yaw * ta - pitch * ta * te) * np.cos(el) ** 2
    # second order of 0.3 deg turns: 0.3^2 pi/180 = 0.0016 deg
    assert displaced_deg(yaw, roll, pitch) == pytest.approx((daz, d_el), abs=0.0025)


def test_rotation_is_the_321_turn() -> None:
    def about(axis: int, angle_deg: float) -> np.ndarray:
        c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        turn = np.eye(3)
        turn[i, i] = turn[j, j] = c
        turn[i, j], turn[j, i] = s, -s
        return turn

    expected = about(0, 11.0) @ about(1, -7.0) @ about(2, 23.0)
    # rounding of products of cosines
    np.testing.assert_allclose(body_from_orbital(np.array([[23.0, 11.0, -7.0]]))[0], expected, atol=1e-15)


def test_antenna_angles_of_the_axes() -> None:
    az, el = antenna_angles_deg(np.array([[1.0, 0.0, 1.0], [0.0, -1.0, 1.0]]))
    np.testing.assert_allclose([az, el], [[45.0, 0.0], [0.0, 45.0]], atol=1e-12)  # East and North positive


def test_orbital_frame_looks_east_south_and_down() -> None:
    frame = orbital_from_earth(SATELLITE_KM, NORMAL)[0]
    # at 90 deg East: East = -x, South = -z, down = -y
    np.testing.assert_allclose(frame, [[-1, 0, 0], [0, 0, -1], [0, -1, 0]], atol=1e-15)


def test_station_position_stands_on_the_ellipsoid() -> None:
    # WGS-84 polar radius 6356.752 km, to a metre
    np.testing.assert_allclose(station_position_km(90.0, 0.0), [0.0, 0.0, 6356.752], atol=1e-3)
    np.testing.assert_allclose(station_position_km(0.0, 90.0, 1000.0), [0.0, 6379.137, 0.0], atol=1e-3)


def test_dish_sees_the_satellite_move_east_and_up() -> None:
    nominal = SATELLITE_KM[0]
    east = nominal + np.array([-42.0, 0.0, 0.0])
    north = nominal + np.array([0.0, 0.0, 42.0])
    motion = dish_motion_deg(station_position_km(55.0, 90.0), nominal, np.array([east, north]))
    # 42 km at some 39 300 km is 0.061 deg; a dish at 55 deg North sees the North as up
    assert motion[0, 0] == pytest.approx(0.061, abs=0.001)
    assert motion[1, 1] > 0.04
    assert abs(motion[1, 0]) < 1e-9


START_US = 1_793_491_200_000_000
DAYS = 6
EPOCHS_US = START_US + np.arange(DAYS * 144, dtype=np.int64) * 600_000_000


def drawn(seed: int) -> Orbit:
    return Orbit.drawn(seed, 90.0, START_US)


@pytest.mark.parametrize("seed", range(20))
def test_motion_and_nodal_period_stay_in_their_ranges(seed: int) -> None:
    orbit = drawn(seed)
    latitude, longitude = orbit.sub_satellite_deg(EPOCHS_US)
    assert 0.02 < np.abs(latitude).max() <= 0.05  # the paper's bound of the orbit's motion
    assert np.abs(longitude - 90.0).max() <= 0.05
    periods_h = np.diff(orbit.ascending_nodes_us(START_US, START_US + DAYS * US_PER_DAY)) / 3.6e9
    assert np.all((periods_h > 23.76) & (periods_h < 24.11))  # range of the method's description


def test_nodes_are_northward_crossings_to_a_microsecond() -> None:
    orbit = drawn(3)
    nodes = np.array(orbit.ascending_nodes_us(START_US, START_US + DAYS * US_PER_DAY))
    assert len(nodes) in {DAYS, DAYS + 1}
    before, after = (orbit.sub_satellite_deg(nodes + step)[0] for step in (-1, 0))
    assert np.all(before < 0.0)
    assert np.all(after >= 0.0)


def test_nodal_period_changes_as_the_node_drifts() -> None:
    nodes = np.array(drawn(1).ascending_nodes_us(START_US, START_US + DAYS * US_PER_DAY))
    assert np.ptp(np.diff(nodes)) > 1e6  # more than a second over six days


def test_orbital_frame_follows_the_inertial_motion() -> None:
    orbit = drawn(2)
    position = orbit.position_km(EPOCHS_US)
    velocity = np.gradient(position, 600.0, axis=0) + np.cross([0.0, 0.0, EARTH_RATE_RAD_S], position)
    normal = np.cross(position, velocity)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    south = orbit.orbital_from_earth(EPOCHS_US)[:, 1, :]
    # y = anti-normal; 1e-4 rad = 0.006 deg covers the one-sided differences at both ends
    np.testing.assert_allclose(south, -normal, atol=1e-4)


def test_frames_are_rotations() -> None:
    frames = drawn(5).orbital_from_earth(EPOCHS_US)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frames.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-14)  # rounding


def test_predicted_track_is_close_and_not_exact() -> None:
    orbit = drawn(4)
    track = predicted_track(orbit, 4, START_US, START_US + DAYS * US_PER_DAY)
    latitude, longitude = orbit.sub_satellite_deg(track.epochs_us)
    error = np.abs([track.latitude_deg - latitude, track.longitude_deg - longitude])
    assert 1e-5 < error.max() < 0.006  # four sigmas of bias and wave together
    assert track.epochs_us[-1] >= START_US + DAYS * US_PER_DAY


PLAN = PLANS["ku16"]
ORBIT = Orbit.drawn(1, 90.0, 1_793_491_200_000_000)
WEEK_US = ORBIT.start_us + np.arange(3 * 144, dtype=np.int64) * 600_000_000


def test_a_beam_falls_by_its_curvature() -> None:
    beam = Beam("b", 1.0, 2.0, 1.5, 2.7)
    # -1.5 / 2 at one degree of azimuth, -2.7 / 2 at one of elevation
    np.testing.assert_allclose(beam.gain_db(np.array([2.0, 1.0]), np.array([2.0, 3.0])), [-0.75, -1.35], atol=1e-12)


def test_a_ripple_adds_its_wave() -> None:
    plain, waved = Beam("b", 0.0, 0.0), Beam("b", 0.0, 0.0, ripples=(Ripple(0.1, 2.0, 0.0, 0.0),))
    point = np.array([np.pi / 2.0]), np.array([0.0])
    np.testing.assert_allclose(waved.gain_db(*point) - plain.gain_db(*point), [-0.1], atol=1e-12)


def test_curvature_is_near_the_stated_figures() -> None:
    step = 0.25
    for axis, expected in ((1, -2.7), (2, -1.5)):
        attitude = np.zeros((3, 3))
        attitude[0, axis], attitude[2, axis] = step, -step
        gain = nominal_gain_db(PLAN, ORBIT, attitude)
        curvature = (gain[0] - 2.0 * gain[1] + gain[2]) / step**2
        assert float(np.mean(curvature)) == pytest.approx(expected, abs=0.2)  # dB/deg^2, mean of the carriers
        assert float(np.std(curvature)) < 0.35  # nearly common


def test_the_downlink_is_common_to_all_carriers() -> None:
    attitude = np.array([[0.0, 0.3, 0.0], [0.0, 0.0, 0.3]])
    flat = Beam("flat", 0.0, 0.0, 0.0, 0.0)
    whole = nominal_gain_db(PLAN, ORBIT, attitude)
    alone = nominal_gain_db(
        type(PLAN)(PLAN.name, PLAN.beams, PLAN.carriers, PLAN.receiving_site, flat), ORBIT, attitude
    )
    assert float(np.max(np.ptp(whole - alone, axis=1))) < 1e-9  # rounding: one number for all


def test_body_held_to_nadir_makes_almost_no_harmonic() -> None:
    gain = attitude_gain_db(PLAN, ORBIT, WEEK_US, np.zeros((len(WEEK_US), 3)))
    # the spec computes 0.0006-0.007 dB for pointing to nadir; the frame also turns with the inclined orbit by up to
    # 0.05 deg of yaw, worth up to 0.017 dB at 0.34 dB/deg
    assert 0.0005 < float(np.abs(gain).max()) < 0.04


def test_sensitivities_have_the_stated_sizes() -> None:
    rms = np.sqrt(np.mean(sensitivity_db_per_deg(PLAN, ORBIT) ** 2, axis=0))
    np.testing.assert_allclose(rms, [0.16, 1.4, 1.2], rtol=0.1)  # dB/deg, figures of the method to 10 %


@pytest.mark.parametrize("seed", range(5))
def test_the_dishes_make_the_harmonics(seed: int) -> None:
    orbit = Orbit.drawn(seed, 90.0, ORBIT.start_us)
    loss = dishes_loss_db(PLAN, orbit, WEEK_US, seed)
    angle = 2.0 * np.pi * np.arange(len(WEEK_US)) / 144.0
    first, second = (2.0 * np.abs(np.exp(1j * k * angle) @ loss) / len(angle) for k in (1, 2))
    print(f"seed {seed}: first {first.round(2)} second {second.round(2)}")
    assert 0.2 < first.max() < 0.6  # the paper's carrier has 0.35 dB
    assert first.min() < 0.12  # wide dishes hardly notice
    assert 0.05 < second.max() <= 0.2  # inevitable at a width of 0.31 deg


def test_loss_is_counted_from_the_nominal_place() -> None:
    assert dish_loss_db(np.zeros((1, 2)), np.array([0.1, 0.2]), 0.5).tolist() == [0.0]


def test_mispointing_is_drawn_once_a_carrier() -> None:
    one = mispointing_deg(1, "c00", 0.5)
    assert one.tolist() == mispointing_deg(1, "c00", 0.5).tolist()
    assert 0.03 <= float(np.hypot(*one)) <= 0.06  # 0.06 to 0.12 of the width
    assert one.tolist() != mispointing_deg(1, "c01", 0.5).tolist()


SHORT = Scenario("short", "for tests", quiet_h=1.0, alignment_h=0.75, operation_h=8.0)
ALC = RepeaterSettings(alc_transponders=("Ku3",))
UPC = RepeaterSettings(power_controlled=("c04",))
MEMBERS = [8, 9, 10, 11]
OTHERS = [k for k in range(16) if k not in MEMBERS]


@cache
def built(figures: RepeaterSettings, *faults: object, plan: str = "ku16") -> World:
    return World(replace(SHORT, repeater=figures, faults=faults, plan=plan), 1)


def at(world: World, hour: float) -> int:
    return int(np.searchsorted(world.rows.epochs_us, world.scenario.operation_start_us + hour * 3.6e9))


def test_level_control_holds_the_sum() -> None:
    levels = np.array([-43.0, -44.0, -42.0])
    arriving = levels + np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, -1.0, 0.5]])
    gain = level_control_db(arriving, levels, np.ones((3, 3), dtype=bool), [0, 1, 2])
    held = np.sum(10.0 ** ((arriving + gain[:, None]) / 10.0), axis=1)
    np.testing.assert_allclose(held, np.sum(10.0 ** (levels / 10.0)), rtol=1e-12)  # rounding
    assert gain[1] == pytest.approx(-1.0, abs=1e-12)


def test_level_control_of_a_silent_transponder_does_nothing() -> None:
    levels = np.array([-43.0, -44.0])
    assert level_control_db(levels[None, :], levels, np.zeros((1, 2), dtype=bool), [0, 1]).tolist() == [0.0]


def test_a_step_of_one_member_moves_the_others_of_its_transponder() -> None:
    step = Step("step", 1, ("c11",), (2.0, 2.0), (2.0, 2.0))
    stepped, plain = built(ALC, step).rows, built(ALC).rows
    change_db = (stepped.carrier_dbm - plain.carrier_dbm)[at(built(ALC), 3.0)]
    sign = np.sign(change_db[11])
    assert np.all(sign * change_db[[8, 9, 10]] < -0.2)  # one of four users by 2 dB moves the sum by 0.4 to 0.7 dB
    assert np.ptp(change_db[[8, 9, 10]]) < 1e-9  # one gain, rounding
    assert stepped.carrier_dbm[:, OTHERS].tobytes() == plain.carrier_dbm[:, OTHERS].tobytes()
    assert np.any(stepped.flags[:, 8] & FaultFlag.LEVEL_CONTROL)


def test_a_member_off_the_air_lifts_the_others() -> None:
    off = SwitchOff("off", ("c10",), (2.0, 2.0), (2.0, 2.0))
    change_db = (built(ALC, off).rows.carrier_dbm - built(ALC).rows.carrier_dbm)[at(built(ALC), 3.0)]
    assert np.all((change_db[[8, 9, 11]] > 0.7) & (change_db[[8, 9, 11]] < 2.0))  # a quarter of the power: 1.2 dB


def test_power_control_takes_rain_away_from_its_carrier_alone() -> None:
    rain = UplinkRain("rain", 1, ("c04",), (2.0, 2.0), (3.0, 3.0), (0.05, 0.05), (60.0, 60.0))
    wet, dry = built(UPC, rain).rows, built(UPC).rows
    left_db = (wet.carrier_dbm - dry.carrier_dbm)[at(built(UPC), 3.2) : at(built(UPC), 3.9), 4]
    assert abs(float(left_db.mean())) < 0.15  # of 3 dB; what is left is the breath of the rain
    others = [k for k in range(16) if k != 4]
    assert wet.carrier_dbm[:, others].tobytes() == dry.carrier_dbm[:, others].tobytes()
    assert np.any(wet.flags[:, 4] & FaultFlag.POWER_CONTROL)


def test_power_control_ends_at_its_limit() -> None:
    added = power_control_db(np.full(100, -20.0), 60.0, 300.0, 6.0)
    assert added[0] == 0.0
    assert added[-1] == 6.0


def test_power_control_also_hides_the_attitude() -> None:
    free, steered = built(RepeaterSettings()).rows, built(UPC).rows
    rows = slice(at(built(UPC), -8.6), at(built(UPC), -1.0))  # the turns
    assert steered.carrier_dbm[rows, 4].std() < 0.6 * free.carrier_dbm[rows, 4].std()


def test_rain_over_the_site_fades_the_c_band_by_a_tenth() -> None:
    rain = DownlinkRain("rain", (2.0, 2.0), (3.0, 3.0), (0.3, 0.3), (60.0, 60.0))
    wet, dry = built(RepeaterSettings(), rain, plan="kuc16"), built(RepeaterSettings(), plan="kuc16")
    row = at(wet, 2.5)
    fade_db = (dry.rows.carrier_dbm - wet.rows.carrier_dbm)[row] / wet.rows.downlink_fade_db[row]
    bands = [carrier.band for carrier in wet.plan.carriers]
    np.testing.assert_allclose(fade_db, [1.0 if band == "Ku" else 0.1 for band in bands], rtol=1e-9)  # rounding
    assert bands.count("Ku") == bands.count("C") == 8


def test_a_shower_over_a_c_band_station_is_a_tenth_too() -> None:
    rain = UplinkRain("rain", 1, ("c12",), (2.0, 2.0), (3.0, 3.0), (0.3, 0.3), (60.0, 60.0))
    fade_db = built(RepeaterSettings(), rain, plan="kuc16").rows.uplink_fade_db[:, 12]
    assert 0.25 < fade_db.max() < 0.4  # 3 dB in Ku, breath of 6 %


def test_a_first_order_series_has_its_spread_and_memory() -> None:
    series = first_order(stream(1, "x"), 40_000, 60.0, 0.1, 1200.0)
    # 40 000 rows hold some 1000 independent values
    assert float(series.std()) == pytest.approx(0.1, rel=0.1)
    lag_one = float(np.corrcoef(series[:-1], series[1:])[0, 1])
    assert lag_one == pytest.approx(np.exp(-60.0 / 1200.0), abs=0.01)


def test_a_series_starts_in_its_stationary_state() -> None:
    starts = [first_order(stream(seed, "x"), 1, 60.0, 0.1, 36_000.0)[0] for seed in range(400)]
    assert float(np.std(starts)) == pytest.approx(0.1, rel=0.15)  # 400 draws: 3.5 %, four sigmas


def test_no_sigma_gives_zeros_and_draws_as_many_numbers() -> None:
    one, other = stream(1, "x"), stream(1, "x")
    assert not first_order(one, 10, 60.0, 0.0, 1200.0).any()
    first_order(other, 10, 60.0, 0.3, 1200.0)
    assert one.normal() == other.normal()


def test_a_longer_series_begins_with_the_shorter() -> None:
    short, long = (first_order(stream(1, "x"), count, 60.0, 0.1, 1200.0) for count in (50, 80))
    np.testing.assert_array_equal(short, long[:50])


def test_a_daily_wave_repeats_after_a_day() -> None:
    wave = daily_wave(stream(1, "x"), np.array([1000.0, 87_400.0, 44_200.0]), 0.04)
    assert wave[0] == pytest.approx(wave[1], abs=1e-12)
    assert wave[0] == pytest.approx(-wave[2], abs=1e-12)


EXACT = {"white_deg": 0.0, "leakage_deg": 0.0, "daily_deg": 0.0, "wander_deg": 0.0}


def world(name: str = "polarized", **changes: float) -> World:
    story = scenario_named(name, operation_days=0.2, quiet_days=0.2)
    assert story.polarimeter is not None
    return World(replace(story, polarimeter=replace(story.polarimeter, **changes)), 1)


def angles_deg(made: World) -> np.ndarray:
    ratio = np.array([report.ratio_db for report in made.polarization])
    return np.degrees(np.arctan(10.0 ** (ratio / 20.0))) - 10.0


def test_a_story_without_a_polarimeter_reports_nothing() -> None:
    assert World(scenario_named("nominal", operation_days=0.1), 1).polarization == ()


def test_the_angle_turns_one_to_one_with_yaw_and_little_with_roll_and_pitch() -> None:
    made = world()
    epochs_us, site = made.rows.epochs_us[:1], made.plan.receiving_site
    turns = [body_turn_deg(made.orbit, site, epochs_us, row[None, :])[0] for row in (np.zeros(3), *(0.1 * np.eye(3)))]
    np.testing.assert_allclose(np.diff([turns[0], turns[1]]), 0.099, atol=1e-3)
    assert np.abs(np.array(turns[2:]) - turns[0]).max() < 0.02


def test_an_exact_polarimeter_reports_turn_and_faraday_rotation() -> None:
    made = world(**EXACT)
    turn_deg = body_turn_deg(made.orbit, made.plan.receiving_site, made.rows.epochs_us, made.rows.attitude_deg)
    left_deg = (angles_deg(made) - turn_deg)[made.rows.downlink_fade_db == 0.0]
    # rotation of a quiet day at 11 GHz
    assert 0.01 < left_deg.min() < left_deg.max() < 0.16
    assert len(made.polarization) == len(made.rows.epochs_us)


@pytest.mark.parametrize(
    ("changes", "moved_deg"),
    [({"feed_turn_deg": 0.5, "feed_turn_from_h": 2.0}, 0.5), ({"leak_drift_deg_h": 0.1}, 0.2)],
)
def test_feed_and_leakage_move_the_angle_in_operation(changes: dict[str, float], moved_deg: float) -> None:
    plain, moved = world(**EXACT), world(**EXACT, **changes)
    hours = (plain.rows.epochs_us - plain.scenario.operation_start_us) / 3.6e9
    apart_deg = angles_deg(moved) - angles_deg(plain)
    assert np.abs(apart_deg[hours < 0.0]).max() == 0.0
    assert apart_deg[hours >= 2.0][1] == pytest.approx(moved_deg, rel=0.1)


SEED = 1


@cache
def structure_world() -> World:
    return World(scenario_named("nominal", operation_days=0.1), SEED)


def test_bound_of_one_row_lies_in_its_ranges() -> None:
    yaw, roll, pitch = crlb_deg(sensitivity_db_per_deg(structure_world().plan, structure_world().orbit))
    print(f"CRLB of one row: yaw {yaw:.3f} roll {roll:.4f} pitch {pitch:.3f} deg")
    assert 0.9 <= yaw <= 1.15
    assert 0.035 <= roll <= 0.055
    assert 0.11 <= pitch <= 0.18


def test_bound_of_a_known_design() -> None:
    sensitivity = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    # two carriers of opposite slope an axis: sigma / sqrt(2), the common unknown costs nothing
    np.testing.assert_allclose(crlb_deg(sensitivity, 0.2), 0.2 / np.sqrt(2.0), rtol=1e-12)


def test_carriers_are_fit_as_planned() -> None:
    found = structure_of(structure_world())
    print(report(structure_world()))
    assert sum(item.is_stable and item.is_linear for item in found) >= 12
    assert [item.id for item in found if not item.is_stable] == ["c08"]  # the user with the unstable level
    assert [item.id for item in found if not item.is_linear] == ["c12"]  # the one on the top of its beam


def test_axes_are_spread() -> None:
    found = structure_of(structure_world())
    sensitivity = np.abs([item.sensitivity_db_per_deg for item in found])
    dominant_roll = [item for item in found if item.main_axis == "roll" and item.axis_ratio >= 2.0]
    assert len(dominant_roll) >= 4
    assert int(np.sum(sensitivity[:, 2] >= 2.0 * sensitivity[:, 1])) >= 5  # pitch over roll
    assert sum(item.main_axis == "yaw" for item in found) >= 3


def test_scaled_yaw_is_bound_by_the_geometry() -> None:
    # 8 |yaw| <= 8 (|el| |pitch| + |az| |roll|) with el <= 8.5 deg and az <= 5.2 deg, 3 % for the tangents
    for item in structure_of(structure_world()):
        yaw, roll, pitch = np.abs(item.sensitivity_db_per_deg)
        assert 8.0 * yaw <= 1.03 * 8.0 * (np.radians(8.5) * pitch + np.radians(5.2) * roll) + 0.02


def test_report_has_a_line_a_carrier() -> None:
    assert len(report(structure_world()).splitlines()) == 1 + 16 + 2
