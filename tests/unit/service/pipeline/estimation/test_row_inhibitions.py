"""Interlock: every reason from what causes it, in the listed order; what is not known forbids."""

from dataclasses import replace

import numpy as np
import pytest

from service.pipeline.config import InterlockConfig
from service.pipeline.estimation.row_inhibitions import INHIBITIONS, RowContext, judge
from service.records.levels.attitude import AttitudeFix

CONFIG = InterlockConfig()
CALM = RowContext(is_late=False, is_catch_up=False, is_settled=True, is_fading=False, has_inhibiting_operation=False)
NAN = float("nan")


def fix(angles=(0.1, 0.1, -0.1), sigma=(0.1, 0.03, 0.05), carriers_used=12):
    covariance = np.diag(np.square(np.array(sigma)))
    return AttitudeFix(0, np.array(angles), covariance, np.zeros(12), np.full(12, 0.05), carriers_used, ())


CAUSES = [
    ("late", fix(), replace(CALM, is_late=True)),
    ("catch_up", fix(), replace(CALM, is_catch_up=True)),
    ("settling", fix(), replace(CALM, is_settled=False)),
    ("no_fix", fix(angles=(NAN, NAN, NAN), sigma=(NAN, NAN, NAN)), CALM),
    ("redundancy", fix(carriers_used=4), CALM),
    ("downlink_fade", fix(), replace(CALM, is_fading=True)),
    ("beyond_validity", fix(angles=(0.0, 0.41, 0.0)), CALM),
    ("beyond_validity", fix(angles=(0.0, 0.0, -0.41)), CALM),
    ("sigma_roll", fix(sigma=(0.1, 0.061, 0.05)), CALM),
    ("sigma_roll", fix(sigma=(0.1, NAN, 0.05)), CALM),
    ("sigma_pitch", fix(sigma=(0.1, 0.03, 0.101)), CALM),
    ("sigma_pitch", fix(sigma=(0.1, 0.03, NAN)), CALM),
    ("operation", fix(), replace(CALM, has_inhibiting_operation=True)),
]
#: rows without angles, written by the archive's synthesis and by the chain, and what the robust method's filter says
ELSEWHERE = {"no_calibration", "not_aligned", "internal_error"}
ELSEWHERE |= {"chain_step", "innovations", "unannounced_motion", "no_ephemeris"}
ELSEWHERE |= {"integrity_unmonitored", "protection_level", "smoothed"}


@pytest.mark.parametrize(("reason", "of_fix", "context"), CAUSES)
def test_each_cause_stands_alone_as_the_reason(reason, of_fix, context):
    verdict = judge(of_fix, context, CONFIG)
    assert verdict.inhibitions == (reason,)
    assert not verdict.is_allowed
    assert verdict.allowed_axes == (False, False, False)


def test_every_listed_reason_is_reachable_and_says_something():
    assert {reason for reason, _, _ in CAUSES} | ELSEWHERE == set(INHIBITIONS)
    assert all(len(text) > 10 for text in INHIBITIONS.values())


def test_several_reasons_are_listed_in_the_order_of_the_table():
    bad = fix(angles=(0.0, 0.5, 0.0), sigma=(0.1, 0.07, 0.2), carriers_used=4)
    all_at_once = RowContext(
        is_late=True, is_catch_up=True, is_settled=False, is_fading=True, has_inhibiting_operation=True
    )
    found = judge(bad, all_at_once, CONFIG).inhibitions
    assert found == tuple(reason for reason in INHIBITIONS if reason in found)
    assert len(found) == len(INHIBITIONS) - len(ELSEWHERE) - 1  # a fix that is there is not `no_fix`


def test_a_good_fix_is_allowed_on_all_axes_and_limits_are_inclusive():
    assert judge(fix(), CALM, CONFIG).allowed_axes == (True, True, True)
    # sqrt(x * x) of a double gives x back for these values
    edge = fix(angles=(0.4, -0.4, 0.4), sigma=(0.2, 0.06, 0.1), carriers_used=5)
    assert judge(edge, CALM, CONFIG).allowed_axes == (True, True, True)


@pytest.mark.parametrize(
    "bad_yaw", [{"sigma": (0.21, 0.03, 0.05)}, {"sigma": (NAN, 0.03, 0.05)}, {"angles": (0.41, 0.1, 0.1)}]
)
def test_yaw_alone_is_withheld_without_an_inhibition(bad_yaw):
    verdict = judge(fix(**bad_yaw), CALM, CONFIG)
    assert (verdict.inhibitions, verdict.allowed_axes) == ((), (False, True, True))


def test_yaw_of_an_unproven_sign_is_withheld_alone():
    unproven = replace(CALM, is_yaw_controllable=False)
    assert judge(fix(), CALM, CONFIG).allowed_axes == (True, True, True)
    assert judge(fix(), unproven, CONFIG).allowed_axes == (False, True, True)
    assert judge(fix(), unproven, CONFIG).inhibitions == ()
