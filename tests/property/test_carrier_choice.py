"""What holds for any choice of carriers: constraints, and that exchange leaves nothing to gain."""

import math

import numpy as np
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from service.core.estimation.carrier_sets import judge_set
from service.core.estimation.design import (
    AXIS_WEIGHTS,
    MAX_TRANSPONDER_SHARE,
    MIN_CARRIERS,
    MIN_REDUNDANCY,
    choose_carriers,
)
from service.core.estimation.observability import crlb_deg


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
    return float(np.sum(np.square(AXIS_WEIGHTS * bound)))


@settings(max_examples=examples(150), deadline=None)
@given(payloads())
def test_constraints_hold_wherever_the_plan_allows(payload):
    sensitivity, sigma, transponder, eligible, count = payload
    design = choose_carriers(sensitivity, sigma, transponder, count, eligible=eligible)
    free = eligible & np.isfinite(sensitivity).all(axis=1)
    assert free[design.chosen].all()
    assert len(set(design.chosen.tolist())) == len(design.chosen) == min(count, free.sum())
    assert design.redundancy == len(design.chosen) - 5
    limit = max(1, math.floor(MAX_TRANSPONDER_SHARE * len(design.chosen)))
    held, there = np.bincount(transponder[design.chosen], minlength=6), np.bincount(transponder[free], minlength=6)
    if np.minimum(there, limit).sum() >= len(design.chosen):
        assert held.max(initial=0) <= limit
    else:
        # no plan could do it, so the share is exceeded as little as possible: one less would not be enough
        assert np.minimum(there, held.max() - 1).sum() < len(design.chosen)
    if design.is_sufficient:
        assert len(design.chosen) >= MIN_CARRIERS
        assert design.redundancy >= MIN_REDUNDANCY
        assert held.max() <= MAX_TRANSPONDER_SHARE * len(design.chosen)
        assert np.isfinite(design.crlb_deg).all()


@settings(max_examples=examples(60), deadline=None)
@given(payloads())
def test_no_allowed_exchange_lowers_the_bound(payload):
    """Every exchange, tried one by one, against what the search says is best."""
    sensitivity, sigma, transponder, eligible, count = payload
    design = choose_carriers(sensitivity, sigma, transponder, count, eligible=eligible)
    if not math.isfinite(design.cost_deg2) or len(design.chosen) < 6:
        return
    limit = max(
        max(1, math.floor(MAX_TRANSPONDER_SHARE * len(design.chosen))), np.bincount(transponder[design.chosen]).max()
    )
    outside = np.setdiff1d(np.flatnonzero(eligible & np.isfinite(sensitivity).all(axis=1)), design.chosen)
    for leaving in design.chosen:
        for coming in outside:
            chosen = np.append(design.chosen[design.chosen != leaving], coming)
            if np.bincount(transponder[chosen]).max() <= limit:
                # the search has a weak prior of 10 deg and 100 dB: it may stop a thousandth early
                assert cost(sensitivity, sigma, chosen) >= design.cost_deg2 * (1.0 - 1e-3)


@settings(max_examples=examples(60), deadline=None)
@given(payloads(), st.randoms(use_true_random=False))
def test_the_order_of_carriers_does_not_matter(payload, random):
    sensitivity, sigma, transponder, eligible, count = payload
    order = list(range(len(sigma)))
    random.shuffle(order)
    design = choose_carriers(sensitivity, sigma, transponder, count, eligible=eligible)
    again = choose_carriers(sensitivity[order], sigma[order], transponder[order], count, eligible=eligible[order])
    assert sorted(order[k] for k in again.chosen) == design.chosen.tolist()


@settings(max_examples=examples(60), deadline=None)
@given(payloads())
def test_levels_of_their_own_never_help(payload):
    """Every transponder under level control: bounds grow, redundancy falls, constraints hold."""
    sensitivity, sigma, transponder, eligible, count = payload
    free = choose_carriers(sensitivity, sigma, transponder, count, eligible=eligible)
    held = choose_carriers(sensitivity, sigma, transponder, count, eligible=eligible, level=transponder)
    assert len(held.chosen) == len(free.chosen)
    assert held.transponder_share <= max(MAX_TRANSPONDER_SHARE, free.transponder_share)
    tied = judge_set(sensitivity[held.chosen], sigma[held.chosen], transponder[held.chosen])
    loose = judge_set(sensitivity[held.chosen], sigma[held.chosen])
    assert tied.redundancy <= loose.redundancy
    if np.isfinite(tied.crlb_deg).all():
        # rounding of a QR at conditions of some hundreds
        assert (tied.crlb_deg >= loose.crlb_deg * (1.0 - 1e-9)).all()
        assert tied.crlb_deg.tolist() == held.crlb_deg.tolist()


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
