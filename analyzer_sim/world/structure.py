"""Structure of a carrier plan: what a careful ground would find about each carrier's fitness.

Three rules, judged on the truth: *stable*, rms of the residual after a fit of one harmonic over the quiet phase at
most 0.25 dB; *linear*, the change along the main axis within 0.5 deg differs from two straight pieces (one slope for
+, one for -) by at most the equivalent of 0.1 deg; *axis*, the main one of |roll|, |pitch| and 8 |yaw|, dominant from
twice the others on. Run `python -m analyzer_sim.world.structure` for the table.
"""

import sys
from dataclasses import dataclass

import numpy as np

from analyzer_sim.epochs import US_PER_S
from analyzer_sim.streams import FloatArray
from analyzer_sim.world.payload.level_terms import nominal_gain_db, sensitivity_db_per_deg
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World

STABLE_DB = 0.25
LINEAR_DEG = 0.1
LINEAR_RANGE_DEG = 0.5
#: yaw moves levels about this much less than roll and pitch
YAW_SCALE = 8.0
#: noise of one row by which the CRLB is stated, dB
CRLB_SIGMA_DB = 0.1857


@dataclass(frozen=True, slots=True)
class CarrierStructure:
    """Figures of one carrier."""

    id: str
    station: str
    #: yaw, roll, pitch, dB/deg
    sensitivity_db_per_deg: tuple[float, float, float]
    residual_db: float
    nonlinearity_deg: float
    main_axis: str
    #: main axis over the next one, yaw scaled by 8
    axis_ratio: float

    @property
    def is_stable(self) -> bool:
        """Return whether one harmonic explains the quiet phase."""
        return self.residual_db <= STABLE_DB

    @property
    def is_linear(self) -> bool:
        """Return whether two straight pieces explain a turn."""
        return self.nonlinearity_deg <= LINEAR_DEG


def crlb_deg(sensitivity: FloatArray, sigma_db: float = CRLB_SIGMA_DB) -> FloatArray:
    """Return the bound (3,) of one row with an unknown common to all carriers, deg; sensitivity (N, 3) in dB/deg."""
    design = np.column_stack([sensitivity, np.ones(len(sensitivity))])
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(design.T @ design)))[:3] * sigma_db)


def structure_of(world: World) -> tuple[CarrierStructure, ...]:
    """Judge every carrier of a world; the world needs a quiet phase."""
    sensitivity = sensitivity_db_per_deg(world.plan, world.orbit)
    residual = _harmonic_residual_db(world)
    scaled = np.abs(sensitivity) * [YAW_SCALE, 1.0, 1.0]
    found = []
    for number, carrier in enumerate(world.plan.carriers):
        order = np.argsort(-scaled[number])
        steeper = 1 if scaled[number, 1] >= scaled[number, 2] else 2
        found.append(
            CarrierStructure(
                carrier.id,
                carrier.station.name,
                (float(sensitivity[number, 0]), float(sensitivity[number, 1]), float(sensitivity[number, 2])),
                float(residual[number]),
                _nonlinearity_deg(world, number, steeper),
                ("yaw", "roll", "pitch")[order[0]],
                float(scaled[number, order[0]] / scaled[number, order[1]]),
            )
        )
    return tuple(found)


def _harmonic_residual_db(world: World) -> FloatArray:
    """Return the rms (N,) of the quiet phase around one harmonic of the nodal period."""
    phase = world.scenario.phases[0]
    rows = world.rows.epochs_us < phase.stop_us
    nodes = world.orbit.ascending_nodes_us(phase.start_us - 2 * 86_400 * US_PER_S, phase.stop_us)
    angle = 2.0 * np.pi * (world.rows.epochs_us[rows] - nodes[-1]) / float(np.mean(np.diff(nodes)))
    design = np.column_stack([np.ones(angle.size), np.cos(angle), np.sin(angle)])
    powers = world.rows.power_dbm[rows]
    fit = design @ np.linalg.lstsq(design, powers, rcond=None)[0]
    return np.asarray(np.std(powers - fit, axis=0))


def _nonlinearity_deg(world: World, number: int, axis: int) -> float:
    """Return the largest distance from the straight pieces along an axis, as an angle."""
    angles = np.linspace(0.0, LINEAR_RANGE_DEG, 51)[1:]
    worst_deg = 0.0
    for sign in (1.0, -1.0):
        attitude = np.zeros((len(angles) + 1, 3))
        attitude[1:, axis] = sign * angles
        gain = nominal_gain_db(world.plan, world.orbit, attitude)[:, number]
        change = gain[1:] - gain[0]
        slope = float(angles @ change / (angles @ angles))
        worst_deg = max(worst_deg, float(np.max(np.abs(change - slope * angles))) / max(abs(slope), 1e-6))
    return worst_deg


def report(world: World) -> str:
    """Write the table of a world."""
    lines = [f"{'carrier':<8}{'station':<26}{'yaw':>7}{'roll':>7}{'pitch':>7}  residual  nonlinear  main axis"]
    for item in structure_of(world):
        angles = "".join(f"{value:7.2f}" for value in item.sensitivity_db_per_deg)
        stable, linear = " " if item.is_stable else "!", " " if item.is_linear else "!"
        marks = f"{item.residual_db:7.3f}{stable} {item.nonlinearity_deg:8.3f}{linear}"
        lines.append(f"{item.id:<8}{item.station:<26}{angles}  {marks}   {item.main_axis} x{item.axis_ratio:.1f}")
    sensitivity = sensitivity_db_per_deg(world.plan, world.orbit)
    rms, bound = np.sqrt(np.mean(sensitivity**2, axis=0)), crlb_deg(sensitivity)
    lines.append("rms sensitivity yaw {:.3f} roll {:.2f} pitch {:.2f} dB/deg".format(*rms))
    lines.append("CRLB of one row yaw {:.3f} roll {:.4f} pitch {:.3f} deg at 0.1857 dB".format(*bound))
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(report(World(scenario_named(sys.argv[1] if len(sys.argv) > 1 else "nominal"), 1)) + "\n")
