"""Claims about when control may use an attitude."""

import numpy as np
import pytest

from service.core.estimation.filtering.watches.integrity import IntegrityInputs, IntegrityLimits, assess

SIGMA, LEVEL = np.array([0.09, 0.01, 0.02]), np.array([0.4, 0.08, 0.12])
CALM = IntegrityInputs(SIGMA, LEVEL, 16, False, False, 1.0, (False, False, False), 0, 16)


def test_a_calm_row_allows_all_axes():
    verdict = assess(CALM, IntegrityLimits())
    assert verdict.is_control_allowed
    assert verdict.is_axis_allowed == (True, True, True)
    assert verdict.reasons == ()
    assert not verdict.is_realignment_advised


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"is_raining": True}, "downlink_fade"),
        ({"is_chain_held": True}, "chain_step"),
        ({"sigma_deg": np.array([0.09, 0.06, 0.02])}, "sigma_roll"),
        ({"sigma_deg": np.array([0.09, 0.01, 0.1])}, "sigma_pitch"),
        ({"sigma_deg": np.array([0.09, 0.01, np.nan])}, "sigma_pitch"),
        ({"protection_deg": np.array([0.4, 0.08, 0.23])}, "protection_level"),
        ({"protection_deg": np.array([0.4, 0.23, 0.12])}, "protection_level"),
        ({"protection_deg": np.array([0.4, np.nan, 0.12])}, "integrity_unmonitored"),
        ({"carriers_used": 5}, "redundancy"),
        ({"nis_ratio": 2.1}, "innovations"),
        ({"is_unannounced": (False, True, False)}, "unannounced_motion"),
        ({"is_command_doubted": True}, "unannounced_motion"),
    ],
)
def test_each_condition_withholds_control_and_says_so(change, reason):
    verdict = assess(CALM._replace(**change), IntegrityLimits())
    assert verdict.reasons == (reason,)
    assert verdict.is_axis_allowed == (False, False, False)


@pytest.mark.parametrize(
    "change", [{"sigma_deg": np.array([0.14, 0.01, 0.02])}, {"is_unannounced": (True, False, False)}]
)
def test_yaw_alone_may_be_withheld(change):
    verdict = assess(CALM._replace(**change), IntegrityLimits())
    assert verdict.is_control_allowed
    assert verdict.is_axis_allowed == (False, True, True)


def test_a_third_of_the_references_learned_anew_advises_an_alignment():
    assert not assess(CALM._replace(relearned=5), IntegrityLimits()).is_realignment_advised
    assert assess(CALM._replace(relearned=6), IntegrityLimits()).is_realignment_advised
