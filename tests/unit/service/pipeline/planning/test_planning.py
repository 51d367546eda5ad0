"""Choices, words and timetables over a payload whose every figure is known."""

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic_payload import START_US, SyntheticPayload

from service.pipeline.planning.assumed_beams import DEFAULT_WIDTHS_DEG, NOISES, AssumedBeam, assume_payload
from service.pipeline.planning.candidates import GONE, NOT_MEASURED, NOT_USABLE, candidates_of
from service.pipeline.planning.planning import Rule, recommend, turn_timetable
from service.records.calibration import NoiseComponent
from service.records.catalogue import Carrier, CarrierPlan, Station
from service.records.levels.attitude import NO_ANGLES

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
