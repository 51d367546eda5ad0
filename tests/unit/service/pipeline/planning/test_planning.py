"""Plans of carriers, sites, beams and gains before they are flown."""

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_flight import FlightPayload
from synthetic_payload import START_US, SyntheticPayload

from service.core.estimation.attitude_bound import WheelStatistics
from service.core.estimation.calibration.whitened_fit import ColouredNoise
from service.core.geometry.frames import station_direction
from service.pipeline.calibration.minute_rows import minute_rows
from service.pipeline.planning.assumed_beams import (
    DEFAULT_WIDTHS_DEG,
    NOISES,
    AssumedBeam,
    ContourBeam,
    ContourPoint,
    assume_payload,
    contour_beams,
    offered_sites,
)
from service.pipeline.planning.planning import (
    GONE,
    MOST_FURTHER,
    NOT_MEASURED,
    NOT_USABLE,
    Rule,
    candidates_of,
    motion_gain,
    recommend,
    stated_wheels,
    turn_timetable,
)
from service.pipeline.planning.quiet_days import (
    ALLAN_SPANS_S,
    QuietDays,
    calmest_window,
    quiet_levels,
    sidereal_orbit,
    suspected_turns,
)
from service.records.calibration import NoiseComponent
from service.records.catalogue import (
    AxisTorques,
    BodyRateSensor,
    Carrier,
    CarrierPlan,
    FedForwardTorque,
    Polarimeter,
    Site,
    Spacecraft,
    Station,
    WheelMomentum,
)
from service.records.levels.attitude import NO_ANGLES
from service.records.levels.measurement import MeasurementSeries

PAYLOAD = SyntheticPayload.make(20)


def plan_of(payload=PAYLOAD, **changes):
    """Return the payload's plan over four transponders, changes by carrier id."""
    carriers = tuple(
        replace(carrier, transponder=f"K{k % 4}", **changes.get(carrier.id, {}))
        for k, carrier in enumerate(payload.carriers())
    )
    return CarrierPlan(1, "plan", carriers)


def result_of(**changes):
    """Return the true calibration, fields of carriers changed by id."""
    result = PAYLOAD.calibration().result
    return replace(result, carriers=tuple(replace(c, **changes.get(c.id, {})) for c in result.carriers))


def test_refused_carriers_say_why_and_are_in_no_set():
    result = result_of(
        c01={"sensitivity_db_per_deg": NO_ANGLES},
        c02={
            "sigma_white_db": math.nan,
            "harmonic": replace(PAYLOAD.calibration().result.carriers[2].harmonic, rms_db=math.nan),
        },
        c04={"criteria_met": ("linear",)},
    )
    plan = plan_of(c00={"uplink_power_control": "auto"}, c03={"enabled": False})
    candidates = candidates_of(result, plan)
    found = recommend(candidates, 16, Rule.OPTIMAL)
    assert candidates.refusals[:4] == (
        (NOT_USABLE,),
        (NOT_MEASURED,),
        ("the calibration has not learned its noise",),
        (NOT_USABLE,),
    )
    assert sorted(found.sets["all"].chosen.tolist()) == list(range(4, 20))
    assert len(found.sets[found.rule].chosen) == 16
    assert 4 in found.sets[found.rule].chosen, "an unsteady user is weighed by its noise, not left out"
    assert 4 not in found.sets["paper"].chosen
    for k in range(4):
        assert found.words[k].rank is None
        assert found.words[k].reasons == candidates.refusals[k]


def test_a_carrier_that_left_the_plan_is_not_chosen():
    plan = plan_of()
    candidates = candidates_of(result_of(), replace(plan, carriers=plan.carriers[1:]))
    assert candidates.refusals[0] == (GONE,)
    assert candidates.is_usable.sum() == 19


def test_a_carrier_that_the_calibration_leaves_out_says_its_reason():
    result = result_of(c02={"rejected_because": ("not linear", "robust: seen in too few stretches of the windows")})
    geometry = SimpleNamespace(is_used=tuple(name != "c02" for name in PAYLOAD.ids), alc_group=())
    candidates = candidates_of(replace(result, geometry=geometry), plan_of())
    assert candidates.refusals[2] == ("the calibration leaves it out: seen in too few stretches of the windows",)
    assert candidates.is_usable.sum() == 19


def test_noise_of_a_row_holds_all_its_parts():
    parts = (NoiseComponent(300.0, 0.05), NoiseComponent(3600.0, 0.12), NoiseComponent(36_000.0, 0.04))
    candidates = candidates_of(result_of(c05={"noise": parts, "sigma_white_db": 0.16}), plan_of())
    assert candidates.sigma_db[5] == pytest.approx(math.sqrt(0.05**2 + 0.12**2 + 0.04**2 + 0.16**2), rel=1e-12)
    assert candidates.sigma_db[0] == pytest.approx(0.05, rel=1e-12), "white alone where nothing else was found"


@pytest.mark.parametrize("rule", list(Rule))
def test_ranks_are_the_order_of_choice(rule):
    found = recommend(candidates_of(result_of(), plan_of()), 12, rule)
    chosen = found.sets[found.rule].chosen
    assert [found.words[k].rank for k in chosen] == list(range(12))
    assert sum(word.rank is None for word in found.words) == 8
    assert all(word.reasons for word in found.words)


def test_the_first_carrier_is_the_one_whose_loss_costs_most():
    candidates = candidates_of(result_of(), plan_of())
    chosen = recommend(candidates, 12, Rule.OPTIMAL).sets["optimal"].chosen

    def cost(kept):
        design = np.column_stack([candidates.sensitivity_db_per_deg[kept], np.ones(len(kept))])
        design /= candidates.sigma_db[kept, np.newaxis]
        return float(np.diag(np.linalg.inv(design.T @ design))[:3] @ np.array([0.0025, 1.0, 1.0]))

    losses = [cost(np.delete(chosen, k)) for k in range(12)]
    assert losses == sorted(losses, reverse=True)


def test_shortcomings_carry_their_figures():
    candidates = candidates_of(result_of(), PAYLOAD.plan())
    found = recommend(candidates, 9, Rule.OPTIMAL)
    assert found.sets[found.rule].shortcomings == (
        "9 carriers; the robust method wants at least 12",
        "4 carriers beyond the unknowns; 6 keep faults from hiding",
        "transponder K1 holds 100% of the carriers; more than 35% fail together when it changes",
    )
    assert recommend(candidates_of(result_of(), plan_of()), 12, Rule.OPTIMAL).sets["optimal"].shortcomings == ()


def test_no_usable_carrier_is_an_answer_too():
    plan = plan_of(**{name: {"enabled": False} for name in PAYLOAD.ids})
    found = recommend(candidates_of(result_of(), plan), 12, Rule.OPTIMAL)
    assert found.sets[found.rule].chosen.size == 0
    assert np.isnan(found.sets[found.rule].figures.crlb_deg).all()
    assert found.sets[found.rule].transponder_share == 0.0


def test_turns_follow_one_another():
    steps = turn_timetable(START_US)
    assert steps[0].start_us == START_US
    assert all(before.stop_us == after.start_us for before, after in itertools.pairwise(steps))
    assert steps[-1].stop_us - START_US == round(8.5 * 3600e6)
    assert steps[-1].attitude_deg == (0.0, 0.0, 0.0)


def test_assumed_beam_falls_by_three_db_at_half_its_width():
    """Slope at the edge of a round beam: -24 (w / 2) / w^2 = -12 / w dB/deg, where it is 3 dB down."""
    carrier = Carrier("c0", "Ku", "K1", 11.2e9, 1e6, Station(0.0, 90.0), 14e9)
    payload = assume_payload((carrier,), 90.0, NOISES["quiet"], {"*": AssumedBeam(-1.5, 0.0, 3.0, 3.0)})
    # a station at nadir: pitch moves it West, so up the slope of a beam in the West
    assert payload.candidates.sensitivity_db_per_deg[0] == pytest.approx([0.0, 0.0, 12.0 / 3.0], abs=1e-12)  # rounding


def test_beams_that_are_not_stated_stand_on_the_middle_of_their_stations():
    carriers = tuple(Carrier(f"c{k}", "Ku", "K1", 11.2e9, 1e6, Station(50.0, 80.0 + 10.0 * k), 14e9) for k in range(3))
    payload = assume_payload(carriers, 90.0, NOISES["links"])
    beam = payload.beams["K1"]
    assert beam.azimuth_deg == pytest.approx(0.0, abs=1e-12)  # rounding: the stations are symmetric
    assert beam.elevation_deg == pytest.approx(float(payload.direction.elevation_deg.mean()), abs=1e-12)
    assert (beam.width_azimuth_deg, beam.width_elevation_deg) == DEFAULT_WIDTHS_DEG
    assert any("assumed on the middle of its stations" in text for text in payload.assumptions)


def test_carriers_under_level_control_count_by_their_differences():
    """All of one transponder under level control: what its carriers do together is invisible."""
    changes = {carrier.id: {"transponder_mode": "alc"} for k, carrier in enumerate(PAYLOAD.carriers()) if k % 4 == 0}
    groups = tuple(0 if k % 4 == 0 else -1 for k in range(20))
    geometry = SimpleNamespace(is_used=(True,) * 20, alc_group=groups)
    plain = candidates_of(result_of(), plan_of())
    held = candidates_of(replace(result_of(), geometry=geometry), plan_of(**changes))
    assert held.level.tolist() == list(groups)
    assert plain.level.tolist() == [-1] * 20
    loose, tied = (recommend(one, 20, Rule.OPTIMAL).sets["all"].figures for one in (plain, held))
    assert tied.redundancy == loose.redundancy - 1
    assert (tied.crlb_deg > loose.crlb_deg).all()
    # the same by hand: what each row of the group has beyond the group's mean, level free for the others only
    members = np.array(groups) == 0
    sensitivity, sigma = held.sensitivity_db_per_deg.copy(), held.sigma_db
    ones = np.where(members, 0.0, 1.0)
    weight = 1.0 / sigma[members] ** 2
    sensitivity[members] -= (weight @ sensitivity[members]) / weight.sum()
    design = np.column_stack([sensitivity, ones]) / sigma[:, np.newaxis]
    bound = np.sqrt(np.diag(np.linalg.inv(design.T @ design)))[:3]
    assert tied.crlb_deg == pytest.approx(bound, rel=1e-9)  # normal equations at a condition of some hundreds


def test_files_say_who_is_under_level_control():
    carriers = tuple(
        Carrier(
            f"c{k}",
            "Ku",
            f"K{min(k // 4, 2)}",
            11.2e9,
            1e6,
            Station(45.0 + 2.0 * k, 70.0 + 5.0 * k),
            14e9,
            transponder_mode="alc" if k // 4 != 1 else "fixed_gain",
        )
        for k in range(10)
    )
    payload = assume_payload(carriers, 90.0, NOISES["links"])
    assert payload.candidates.level.tolist() == [0] * 4 + [-1] * 4 + [1] * 2
    assert payload.candidates.refusals[9] == (
        "its transponder is under level control and has fewer than 3 carriers in the plan",
    )
    assert "K0, K2 under level control: only differences between their carriers count" in payload.assumptions


def test_a_beacon_has_no_beam():
    beacon = Carrier("b0", "Ku", "K9", 11.2e9, 1e3, kind="beacon")
    payload = assume_payload((beacon,), 90.0, NOISES["links"])
    assert payload.candidates.refusals == ((NOT_USABLE,),)
    assert payload.beams == {}


QUIET_START_US = 1_795_219_200_000_000
HOUR_US = 3_600_000_000
EPOCHS_US = QUIET_START_US + 60_000_000 * np.arange(4320, dtype=np.int64)
#: yaw, roll, pitch of twelve carriers, dB/deg
SLOPE = np.random.default_rng(3).normal(0.0, [0.15, 1.4, 1.2], (12, 3))
NOISE_DB = np.random.default_rng(4).normal(0.0, 0.15, (4320, 12))


def hours(first, last):
    return slice(round(first * 60), round(last * 60))


def test_the_daily_change_is_removed():
    carriers = tuple(Carrier(f"c{k:02d}", "Ku", "Ku1", 11.2e9, 1e6, Station(50.0 + k, 80.0)) for k in range(12))
    spacecraft = Spacecraft("s", "s", 90.0, Site(55.0, 38.0), ((1, 0, 0), (0, 1, 0), (0, 0, 1)), 0.05)
    orbit = sidereal_orbit(QUIET_START_US, int(EPOCHS_US[-1]))
    daily_db = 0.3 * np.cos(2.0 * np.pi * (EPOCHS_US - QUIET_START_US) / 86_164.0905e6 + 1.0)
    series = MeasurementSeries(tuple(c.id for c in carriers), EPOCHS_US, -72.0 + daily_db[:, np.newaxis] + NOISE_DB)
    plan = CarrierPlan(1, "", carriers)
    levels = quiet_levels(QuietDays(spacecraft, plan, orbit, minute_rows([series], plan.carrier_ids, ())))
    for fit in levels.harmonics:
        assert fit.law == "two_harmonics"
        assert fit.harmonic.amplitude_db == pytest.approx(0.3, abs=0.02)
    assert levels.residual_db.std(axis=0) == pytest.approx(np.full(12, 0.15), rel=0.05)
    assert levels.allan_db.shape == (len(ALLAN_SPANS_S), 12)
    assert levels.allan_db[0] == pytest.approx(np.full(12, 0.15), rel=0.1)


def test_calm_hours_are_found_between_weather_and_gaps():
    residual = NOISE_DB.copy()
    residual[hours(0, 30), :6] -= 2.0
    residual[hours(45, 72), 3:9] = np.nan
    found = calmest_window(EPOCHS_US, residual, round(8.5 * HOUR_US))
    assert found.start_us >= QUIET_START_US + 30 * HOUR_US
    assert found.stop_us <= QUIET_START_US + 45 * HOUR_US


def test_a_dead_carrier_does_not_matter():
    residual = NOISE_DB.copy()
    residual[:, 4] = np.nan
    residual[hours(0, 60)] *= 3.0
    assert calmest_window(EPOCHS_US, residual, 8 * HOUR_US).start_us >= QUIET_START_US + 60 * HOUR_US


def test_turns_are_suspected_and_dated():
    residual = NOISE_DB.copy()
    residual[hours(20, 21)] += SLOPE @ [0.0, 0.4, 0.0]
    residual[hours(21, 22)] += SLOPE @ [0.0, 0.0, -0.3]
    (found,) = suspected_turns(EPOCHS_US, residual, SLOPE)
    assert (found.window.start_us - QUIET_START_US) / HOUR_US == pytest.approx(20.0, abs=0.2)
    assert (found.window.stop_us - QUIET_START_US) / HOUR_US == pytest.approx(22.0, abs=0.2)
    assert found.reach_deg == pytest.approx(0.4, abs=0.05)


def test_weather_and_noise_are_no_turns():
    residual = NOISE_DB.copy()
    residual[hours(5, 9), :3] -= 3.0  # rain over three stations
    residual[hours(30, 33)] -= 2.0  # rain over the receiving site
    residual[hours(50, 60), 7] += 1.5  # a user that stepped
    assert suspected_turns(EPOCHS_US, residual, SLOPE) == ()
    assert suspected_turns(EPOCHS_US, residual, np.full((12, 3), np.nan)) == ()


BEAMS = {"Ku0": AssumedBeam(-3.0, 7.0, 4.0, 3.0), "Ku1": AssumedBeam(2.0, 7.0, 4.0, 3.0)}


def payload(count=14):
    carriers = tuple(
        Carrier(f"c{k:02d}", "Ku", f"Ku{k % 2}", 11.2e9, 1e6, Station(45.0 + 3.0 * (k % 8), 40.0 + 7.0 * k))
        for k in range(count)
    )
    return assume_payload(carriers, 90.0, NOISES["quiet"], BEAMS)


def test_sites_lie_under_their_beams():
    known = payload()
    offered = offered_sites(known, known.candidates)
    assert offered.is_usable.all()
    for name, transponder in zip(offered.carrier_ids, offered.transponders, strict=True):
        north, east = name.split()
        latitude = float(north[:-1]) * (1.0 if north.endswith("N") else -1.0)
        longitude = float(east[:-1]) * (1.0 if east.endswith("E") else -1.0)
        seen = station_direction([longitude], [latitude], [0.0], 90.0)
        assert BEAMS[transponder].shape_at(seen.azimuth_deg, seen.elevation_deg).gain_db[0] > -12.0
    assert np.allclose(offered.sigma_db, known.candidates.sigma_db[0])


def test_further_carriers_lower_the_bounds_one_after_the_other():
    known = payload()
    alone = recommend(known.candidates, 8, Rule.OPTIMAL)
    assert [one.in_plan for one in alone.further] == [True] * MOST_FURTHER
    assert not {one.carrier for one in alone.further} & {
        known.candidates.carrier_ids[k] for k in alone.sets["optimal"].chosen
    }
    offered = recommend(known.candidates, 14, Rule.OPTIMAL, offered=offered_sites(known, known.candidates))
    assert [one.in_plan for one in offered.further] == [False] * MOST_FURTHER
    for one in (*alone.further, *offered.further):
        assert max(one.bound_ratio) <= 1.0 + 1e-9
        assert min(one.bound_ratio) < 0.99


def test_what_is_determined_by_nothing_gets_no_advice():
    known = payload(3)
    assert recommend(known.candidates, 3, Rule.OPTIMAL).further == ()


STATED = WheelMomentum(sigma_n_m_s=0.02, misalignment_deg=0.1, pitch_bias_n_m_s=-9.0)


def test_without_a_stated_momentum_there_is_nothing_to_plan_with():
    assert stated_wheels(None, None, 0.01, 300.0) is None
    assert stated_wheels(WheelMomentum(), None, None, 300.0) is None


def test_options_prevail_over_the_catalogue():
    wheels = stated_wheels(STATED, None, None, 3600.0)
    assert wheels[:4] == (-9.0, 0.02, 3600.0, 0.1)
    wheels = stated_wheels(STATED, 8.0, 0.05, 300.0)
    assert wheels[:3] == (8.0, 0.05, 300.0)


def test_the_error_of_a_stated_profile_is_its_share():
    torque = AxisTorques(yaw=1e-5, roll=1e-5)
    profile = FedForwardTorque(0, 86_400.0, torque, torque, torque, relative_error=0.03, axis_relative_error=0.04)
    wheels = stated_wheels(WheelMomentum(pitch_bias_n_m_s=8.0, torque=profile), None, None, 300.0)
    assert wheels.torque_error_n_m == pytest.approx(math.hypot(0.03, 0.04) * 1e-5)


def test_the_bound_knows_what_the_catalogue_states_to_measure_motion():
    slopes = np.random.default_rng(3).normal(0.0, [0.12, 1.0, 0.8], (8, 3))
    noise = ColouredNoise(np.full(8, 0.1), np.full((8, 1), 0.1), np.full((8, 1), 1200.0))
    candidates: Any = SimpleNamespace(sensitivity_db_per_deg=slopes, noise=noise)
    chosen, wheels, plain = np.arange(8), WheelStatistics(8.0), FlightPayload.make().spacecraft()
    assert motion_gain(candidates, chosen, plain, wheels) is None
    beside = BodyRateSensor(in_loop=False, bias_deg_h=0.01, bias_tau_h=8.0, noise_deg_sqrt_h=0.003)
    in_loop = replace(plain, onboard=replace(plain.onboard, rate_sensor=BodyRateSensor(in_loop=True)))
    assert motion_gain(candidates, chosen, in_loop, wheels) is None
    rated = replace(plain, onboard=replace(plain.onboard, rate_sensor=beside))
    seen = replace(rated, polarimeters=(Polarimeter("p", 10.0, 11e9), Polarimeter("q", 5.0, 11e9, used=False)))
    alone, both = (motion_gain(candidates, chosen, craft, None) for craft in (rated, seen))
    more = motion_gain(candidates, chosen, seen, wheels)
    assert alone.polarization_deg is None
    assert alone.rates_deg == alone.all_deg == both.rates_deg
    assert both.all_deg.yaw < both.polarization_deg.yaw < both.powers_deg.yaw
    assert more.all_deg.yaw < both.all_deg.yaw < both.rates_deg.yaw


LONGITUDE_DEG = 90.0
STATIONS = ((56.0, 60.0), (52.0, 85.0), (60.0, 70.0))


def carriers(transponder="Ku1"):
    return tuple(
        Carrier(f"c{k}", "Ku", transponder, 11.2e9, 1e6, Station(latitude, longitude))
        for k, (latitude, longitude) in enumerate(STATIONS)
    )


def gain_db(latitude_deg, longitude_deg):
    seen = station_direction([longitude_deg], [latitude_deg], [0.0], LONGITUDE_DEG)
    u, v = float(seen.azimuth_deg[0]) + 2.0, float(seen.elevation_deg[0]) - 8.0
    return -0.8 * u**2 + 0.3 * u * v - 1.3 * v**2


def grid(step_deg=2.0, low=40.0):
    sites = [(n, e) for n in np.arange(low, 72.1, step_deg) for e in np.arange(46.0, 100.1, step_deg)]
    return [
        ContourPoint(line, "Ku1", float(n), float(e), gain_db(float(n), float(e)))
        for line, (n, e) in enumerate(sites, start=2)
    ]


def test_a_quadratic_comes_back():
    beam = contour_beams(grid(), carriers(), LONGITUDE_DEG)["Ku1"]
    shape = beam.shape_at(np.array([-3.0]), np.array([8.3]))
    u, v = -3.0 + 2.0, 8.3 - 8.0
    assert shape.gain_db[0] == pytest.approx(-0.8 * u**2 + 0.3 * u * v - 1.3 * v**2)
    assert shape.gradient_db_per_deg[0] == pytest.approx([-1.6 * u + 0.3 * v, 0.3 * u - 2.6 * v])
    assert shape.hessian_db_per_deg2[0] == pytest.approx([-1.6, 0.3, -2.6])


def test_points_far_away_tell_nothing():
    beam = contour_beams(grid(), carriers(), LONGITUDE_DEG)["Ku1"]
    assert np.isnan(beam.shape_at(np.array([4.0]), np.array([-3.0])).gain_db).all()


def test_a_single_contour_does_not_tell_the_slope_across_it():
    along = np.linspace(-2.0, 2.0, 200)
    line = ContourBeam(along, 8.0 + 0.02 * along, np.full(200, -3.0))
    assert np.isnan(line.shape_at(np.array([0.0]), np.array([8.0])).gradient_db_per_deg).all()


def test_three_contours_tell_it():
    angle = np.linspace(0.0, 2.0 * np.pi, 120)
    rings = [(r * np.cos(angle), 8.0 + r * np.sin(angle), np.full(120, -1.3 * r**2)) for r in (1.0, 1.4, 1.8)]
    beam = ContourBeam(*(np.concatenate(part) for part in zip(*rings, strict=True)))
    shape = beam.shape_at(np.array([1.4]), np.array([8.0]))
    assert shape.gradient_db_per_deg[0] == pytest.approx([-2.6 * 1.4, 0.0], abs=0.05)


def test_points_that_are_not_seen_are_refused():
    west = [one._replace(longitude_deg=one.longitude_deg - 150.0) for one in grid()]
    with pytest.raises(ValueError, match=r"points: line 2: the satellite at 90 deg East stands at -"):
        contour_beams(west, carriers(), LONGITUDE_DEG)


def test_exchanged_coordinates_are_named():
    station = (Carrier("c0", "Ku", "Ku1", 11.2e9, 1e6, Station(42.0, 74.0)),)
    sites = [(n, e) for n in np.arange(34.0, 50.1, 2.0) for e in np.arange(66.0, 80.1, 2.0)]
    straight = [ContourPoint(2, "Ku1", n, e, gain_db(n, e)) for n, e in sites]
    assert "Ku1" in contour_beams(straight, station, LONGITUDE_DEG)
    swapped = [one._replace(latitude_deg=one.longitude_deg, longitude_deg=one.latitude_deg) for one in straight]
    with pytest.raises(ValueError, match=r"of Ku1 \(first: line 2\) .*; latitude and longitude look exchanged"):
        contour_beams(swapped, station, LONGITUDE_DEG)


def test_points_of_another_region_are_refused():
    south = [one._replace(latitude_deg=-one.latitude_deg) for one in grid()]
    with pytest.raises(ValueError, match="do not reach a station of the plan; check transponder, satellite"):
        contour_beams(south, carriers(), LONGITUDE_DEG)


def test_points_below_the_horizon_do_not_count():
    known = contour_beams(grid(), carriers(), LONGITUDE_DEG)["Ku1"]
    beyond = [ContourPoint(9000 + k, "Ku1", 50.0, -60.0 - k, -20.0) for k in range(20)]
    assert len(contour_beams(grid() + beyond, carriers(), LONGITUDE_DEG)["Ku1"].gain_db) == len(known.gain_db)
