"""The robust chain and the choice of carriers."""

import math
from functools import cache
from itertools import pairwise

import numpy as np
from example_counts import examples
from geometry_flight import Flight, FlightPayload
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from service.core.estimation.design import choose_carriers, largest_share, most_share, weighted_variance_deg2
from service.core.estimation.observability import crlb_deg, judge_set
from service.pipeline.inputs.known_motion import CommandedMotion, consume, heard
from service.records.catalogue import Method
from service.records.inputs import Correction
from service.records.levels.attitude import Axes, Status

#: the same examples each time; a chain is too slow to look for the smallest
steady = settings(derandomize=True, deadline=None, phases=(Phase.explicit, Phase.generate))
NAN = float("nan")
CARRIERS = 10


@cache
def payload():
    """Return one payload for all examples."""
    return FlightPayload.make(CARRIERS)


def noise_db(seed, minute):
    return 0.05 * np.random.default_rng((seed, minute)).normal(size=CARRIERS)


#: what may happen to one row: carriers that are absent, and levels that jump
holes = st.lists(st.sets(st.integers(0, CARRIERS - 1)), min_size=4, max_size=4)
jumps = st.lists(st.floats(-8.0, 8.0), min_size=CARRIERS, max_size=CARRIERS)


@settings(steady, max_examples=8)
@given(
    order=st.permutations(range(CARRIERS)),
    absent=holes,
    jump=jumps,
    hit=st.sets(st.integers(0, 9)),
    seed=st.integers(0, 99),
)
def test_the_order_of_the_carriers_does_not_matter(order, absent, jump, hit, seed):
    taken = np.array(order)
    straight = Flight(payload(), methods=(Method.ROBUST,))
    shuffled = Flight(payload().permuted(taken), methods=(Method.ROBUST,))
    for minute in range(1, 25):
        change = noise_db(seed, minute)
        change[list(absent[minute % 4])] = NAN
        if minute >= 12:
            change[list(hit)] += np.array(jump)[list(hit)]
        one = straight.robust(straight.changed(minute, change))
        other = shuffled.robust(shuffled.changed(minute, change[taken]))
        # sums in another order: the stated bound
        np.testing.assert_allclose(other.attitude_deg, one.attitude_deg, atol=1e-9)
        np.testing.assert_allclose(other.sigma_deg, one.sigma_deg, atol=1e-9)
        assert other.inhibitions == one.inhibitions
        assert set(other.excluded) == set(one.excluded)


level = st.one_of(st.floats(-250.0, 50.0), st.just(NAN), st.just(None))


@settings(steady, max_examples=examples(30))
@given(
    rows=st.lists(
        st.tuples(st.floats(0.01, 4000.0), st.lists(level, min_size=CARRIERS, max_size=CARRIERS)),
        min_size=1,
        max_size=12,
    )
)
def test_whatever_the_powers_a_row_is_a_row_and_tells_no_angle_that_is_none(rows):
    flight, minute = Flight(payload(), methods=(Method.ROBUST,)), 0.0
    for wait, levels in rows:
        minute += wait
        row = flight.row(minute)
        # None keeps the true power
        power = np.array(
            [own if reported is None else reported for own, reported in zip(row.power_dbm, levels, strict=True)]
        )
        reported = flight.robust(flight.changed(minute, power - row.power_dbm))
        angles, sigma = np.array(reported.attitude_deg), np.array(reported.sigma_deg)
        assert reported.status in (Status.ACQUIRED, Status.EXPIRED)
        assert np.isfinite(angles).all()
        assert (sigma > 0.0).all()
        assert reported.control_allowed == (not reported.inhibitions)
        assert reported.carriers_used + len(reported.excluded) == CARRIERS
        assert len({item.carrier for item in reported.excluded}) == len(reported.excluded)
        if reported.carriers_used < 4:
            assert reported.status is Status.EXPIRED
            assert "redundancy" in reported.inhibitions
        if reported.control_allowed:
            assert sigma[1] < 0.06
            assert sigma[2] < 0.10


@settings(steady, max_examples=6)
@given(
    late=st.lists(
        st.tuples(
            st.integers(1, 20), st.integers(-500, 20 * 60), st.lists(level, min_size=CARRIERS, max_size=CARRIERS)
        ),
        max_size=4,
    )
)
def test_late_rows_leave_the_rows_after_them_bit_for_bit(late):
    plain, disturbed = Flight(payload()), Flight(payload())
    for minute in range(1, 25):
        assert repr(disturbed.feed(disturbed.changed(minute, noise_db(1, minute)))) == repr(
            plain.feed(plain.changed(minute, noise_db(1, minute)))
        )
        for after, second, levels in late:
            if after != minute:
                continue
            row = disturbed.row(min(second / 60.0, float(minute)))
            reported = np.array([own if one is None else one for own, one in zip(row.power_dbm, levels, strict=True)])
            rows = disturbed.feed(disturbed.changed(min(second / 60.0, float(minute)), reported - row.power_dbm))
            assert all("late" in one.inhibitions and not one.control_allowed for one in rows.values())
            assert all(
                one.status is not Status.ACQUIRED or np.isfinite(one.attitude_deg).all() for one in rows.values()
            )


moment = st.integers(0, 3600)


@settings(steady, max_examples=examples(150))
@given(
    begin=moment,
    length=st.integers(0, 3600),
    since=moment,
    known_at=moment,
    cuts=st.sets(moment, max_size=12),
    size=st.floats(-1.0, 1.0),
)
def test_a_correction_counts_once_however_rows_cut_it_and_whenever_it_becomes_known(
    begin, length, since, known_at, cuts, size
):
    s = 1_000_000
    newest_us = max(since, known_at) * s
    correction = Correction(begin * s, (begin + length) * s, Axes(0.0, size, 0.0))
    commanded = heard(CommandedMotion(since * s), correction, None, newest_us)
    epochs_us = [newest_us, *sorted(cut * s for cut in cuts if cut * s > newest_us), 8000 * s]
    total = 0.0
    for before_us, now_us in pairwise(epochs_us):
        known, commanded = consume(commanded, before_us, now_us)
        total += known.correction_deg[1] + known.late_correction_deg[1]
    # an instant lasts a microsecond; before the alignment it is part of it
    stop_us = max(correction.stop_us, correction.start_us + 1)
    share = np.clip((stop_us - max(since * s, correction.start_us)) / (stop_us - correction.start_us), 0.0, 1.0)
    np.testing.assert_allclose(total, size * share, atol=1e-12)
    assert commanded.motions == ()


@st.composite
def payloads(draw):
    """Return sensitivities, noise, transponders, eligibility and a count."""
    total = draw(st.integers(5, 40))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    transponders = draw(st.integers(1, 6))
    sensitivity = rng.normal(0.0, [0.16, 1.4, 1.2], (total, 3))
    sensitivity[rng.random(total) < 0.1] = np.nan
    return (
        sensitivity,
        rng.uniform(0.05, 0.4, total),
        rng.integers(0, transponders, total),
        rng.random(total) < 0.9,
        draw(st.integers(5, total)),
    )


def cost(sensitivity, sigma, chosen):
    bound = crlb_deg(sensitivity[chosen], sigma[chosen], with_common=True)
    return float(weighted_variance_deg2(bound))


def allowed(count):
    """Carriers of one transponder: 35 of a hundred, or what three transponders can do."""
    return max(1, (35 * count) // 100, -(-count // 3))


@settings(max_examples=examples(150), deadline=None)
@given(payloads())
def test_constraints_hold_wherever_the_plan_allows(payload):
    sensitivity, sigma, transponder, eligible, count = payload
    carriers = choose_carriers(sensitivity, sigma, transponder, count, eligible=eligible)
    free = eligible & np.isfinite(sensitivity).all(axis=1)
    assert free[carriers].all()
    assert len(set(carriers.tolist())) == len(carriers) == min(count, free.sum())
    limit = allowed(len(carriers))
    held, there = np.bincount(transponder[carriers], minlength=6), np.bincount(transponder[free], minlength=6)
    if np.minimum(there, limit).sum() >= len(carriers):
        assert held.max(initial=0) <= limit
    else:
        # no plan could do it, so the share is exceeded as little as possible: one less would not be enough
        assert np.minimum(there, held.max() - 1).sum() < len(carriers)


@settings(max_examples=examples(60), deadline=None)
@given(payloads())
def test_no_allowed_exchange_lowers_the_bound(payload):
    """Every exchange, tried one by one, against what the search says is best."""
    sensitivity, sigma, transponder, eligible, count = payload
    carriers = choose_carriers(sensitivity, sigma, transponder, count, eligible=eligible)
    if not math.isfinite(cost(sensitivity, sigma, carriers)) or len(carriers) < 6:
        return
    limit = max(allowed(len(carriers)), np.bincount(transponder[carriers]).max())
    outside = np.setdiff1d(np.flatnonzero(eligible & np.isfinite(sensitivity).all(axis=1)), carriers)
    for leaving in carriers:
        for coming in outside:
            chosen = np.append(carriers[carriers != leaving], coming)
            if np.bincount(transponder[chosen]).max() <= limit:
                # the search has a weak prior of 10 deg and 100 dB: it may stop a thousandth early
                assert cost(sensitivity, sigma, chosen) >= cost(sensitivity, sigma, carriers) * (1.0 - 1e-3)


@settings(max_examples=examples(60), deadline=None)
@given(payloads(), st.randoms(use_true_random=False))
def test_the_order_of_carriers_does_not_matter(payload, random):
    sensitivity, sigma, transponder, eligible, count = payload
    order = list(range(len(sigma)))
    random.shuffle(order)
    carriers = choose_carriers(sensitivity, sigma, transponder, count, eligible=eligible)
    again = choose_carriers(sensitivity[order], sigma[order], transponder[order], count, eligible=eligible[order])
    assert sorted(order[k] for k in again) == carriers.tolist()


@settings(max_examples=examples(60), deadline=None)
@given(payloads())
def test_levels_of_their_own_never_help(payload):
    """Every transponder under level control: bounds grow, redundancy falls, constraints hold."""
    sensitivity, sigma, transponder, eligible, count = payload
    free = choose_carriers(sensitivity, sigma, transponder, count, eligible=eligible)
    held = choose_carriers(sensitivity, sigma, transponder, count, eligible=eligible, level=transponder)
    assert len(held) == len(free)
    share = largest_share(transponder[held])
    assert share <= max(most_share(len(held)), largest_share(transponder[free]))
    tied = judge_set(sensitivity[held], sigma[held], transponder[held])
    loose = judge_set(sensitivity[held], sigma[held])
    assert tied.redundancy <= loose.redundancy
    if np.isfinite(tied.crlb_deg).all():
        # rounding of a QR at conditions of some hundreds
        assert (tied.crlb_deg >= loose.crlb_deg * (1.0 - 1e-9)).all()


@settings(max_examples=examples(100), deadline=None)
@given(payloads())
def test_figures_of_a_set_agree_with_one_another(payload):
    sensitivity, sigma, _, _, _ = payload
    figures = judge_set(sensitivity, sigma)
    if np.isnan(figures.crlb_deg).any():
        assert np.isnan(figures.leverage).all()
        return
    # rounding of a QR at conditions of some hundreds
    assert abs(np.nansum(figures.leverage) - 4.0) < 1e-9
    assert (figures.crlb_deg >= figures.crlb_without_common_deg * (1.0 - 1e-9)).all()
    assert 0.0 <= figures.common_share <= 1.0 + 1e-9
    present = np.isfinite(figures.leverage)
    assert (figures.undetectable_fault_db[present] >= 3.9 * sigma[present]).all(), "the gate is at four sigma"
    # a carrier that nothing checks hides any fault; among the others more leverage hides more
    checked = np.flatnonzero(figures.leverage < 1.0 - 1e-5)
    hidden = figures.undetectable_fault_db[checked] / sigma[checked]
    assert (np.diff(hidden[np.argsort(figures.leverage[checked])]) >= -1e-9).all()
