"""The published method by single functions: fixes of one row, compiled for tests of many rows."""

import numpy as np

from service.core.compiled_entry import CompiledEntry
from service.core.estimation.paper import harmonic, snapshot
from service.core.estimation.paper.downlink_fade import LIMITS
from service.core.estimation.paper.harmonic import evaluate_harmonic
from service.core.geometry.line_of_sight import node_phase_at_rad

_SOLVE = CompiledEntry(snapshot.solve_octants, (harmonic, snapshot))
_REJECT = CompiledEntry(snapshot.reject_faded_carriers, (harmonic, snapshot))
#: settings of the rule of fades as in print
FADE_LIMITS = np.zeros(1, LIMITS)[0]
FADE_LIMITS["fade_depth_db"], FADE_LIMITS["fade_share"], FADE_LIMITS["fade_spread_ratio"] = 0.3, 0.8, 0.5
FADE_LIMITS["fade_entry_s"], FADE_LIMITS["fade_exit_s"], FADE_LIMITS["fade_max_gap_s"] = 300.0, 600.0, 300.0


def solve(plus, minus, deviation_db):
    """Return the fix of the carriers whose numbers are finite."""
    is_present = np.isfinite(deviation_db + (plus + minus).sum(axis=1))
    return _SOLVE(*map(np.array, (plus, minus, deviation_db, is_present)))


def reject(plus, minus, deviation_db, gate_db=1.5, gate_sigma=3.0, min_carriers=4):
    """Return the fix without carriers that rain has hit."""
    return _REJECT(*map(np.array, (plus, minus, deviation_db)), float(gate_db), float(gate_sigma), min_carriers)


def left_out(result):
    """Return which carriers (N,) were present but rejected."""
    return result.reason > snapshot.ABSENT


def expected_dbm(epoch_us, expected, ephemeris):
    """Return the expected powers (N,) of an epoch."""
    phase = node_phase_at_rad(epoch_us, ephemeris.ascending_nodes_us, ephemeris.nodal_period_s)
    return expected.reference_dbm + evaluate_harmonic(phase, expected.amplitude_db, expected.phase_rad)
