"""Catalogue, third part: worlds that differ from what the estimator believes, and reports that are wrong."""

from analyzer_sim.world.scenario.events import FalseReport
from analyzer_sim.world.scenario.story import KeepingErrors, NoiseStatistics, Scenario

_PLAIN_DRIFT_DEG_H = KeepingErrors().drift_deg_h
_TRIPLE_DRIFT_DEG_H = (3.0 * _PLAIN_DRIFT_DEG_H[0], 3.0 * _PLAIN_DRIFT_DEG_H[1], 3.0 * _PLAIN_DRIFT_DEG_H[2])


def _false_reports(name: str, executed_share: float, command: str) -> Scenario:
    """Return two days with two slews of 0.15 deg an axis of which the spacecraft does only a share."""
    reports = tuple(FalseReport(f"slew {day}", 9.0 + 21.0 * day, executed_share) for day in range(2))
    summary = (
        f"Twice in two days, for two hours, announced corrections of 0.15 deg an axis are {command} by the spacecraft."
    )
    return Scenario(name, summary, manoeuvres=reports)


WRONG: tuple[Scenario, ...] = (
    Scenario(
        "nominal_tau5",
        "As nominal; the coloured noise of the carriers lasts 5 min instead of 20.",
        noise=NoiseStatistics(coloured_tau_s=300.0),
    ),
    Scenario(
        "nominal_tau120",
        "As nominal; the coloured noise of the carriers lasts 120 min instead of 20.",
        noise=NoiseStatistics(coloured_tau_s=7200.0),
    ),
    Scenario(
        "nominal_drift3",
        "As nominal; the inertial model drifts three times as fast.",
        keeping=KeepingErrors(drift_deg_h=_TRIPLE_DRIFT_DEG_H),
    ),
    Scenario(
        "nominal_uncoupled",
        "As nominal; roll and yaw do not exchange although the catalogue says that they do.",
        keeping=KeepingErrors(is_coupled=False),
    ),
    Scenario("nominal_10s", "As nominal, a row each 10 s.", row_period_s=10.0),
    Scenario("nominal_300s", "As nominal, a row each 300 s.", row_period_s=300.0),
    _false_reports("corrections_flipped", -1.0, "carried out with the other sign"),
    _false_reports("corrections_halved", 0.5, "carried out by half"),
    _false_reports("corrections_lost", 0.0, "not carried out"),
    _false_reports("corrections_doubled", 2.0, "carried out twice"),
)
