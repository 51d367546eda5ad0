"""Catalogue: the stories by which the method is measured, stories of sources, and stories for closed loops alone."""

from dataclasses import replace

import numpy as np

from analyzer_sim.streams import stream
from analyzer_sim.world.scenario import events
from analyzer_sim.world.scenario.story import KeepingErrors, NoiseStatistics, ResidualTorque, Scenario
from analyzer_sim.world.sensors import EARTH_SENSOR, RADIO_BEACON

#: size of the angles from which the loop slews to zero, deg
SLEW_DEG = 0.35
#: size of the torques that nobody knows, N m
_RESIDUAL_N_M = (2e-7, 2e-6)
#: of which each seed of the varied plant has one
SHAPES, ROWS_S = ("constant", "daily", "eclipse"), (60.0, 10.0, 300.0, 30.0, 120.0, 20.0)


def plant_varied(seed: int) -> Scenario:
    """Return a day on a plant that differs from what its catalogue says, otherwise with each seed."""
    rng = stream(seed, "varied plant")
    yaw, roll, pitch = rng.uniform(0.9, 1.1, 3).tolist()
    keeping = KeepingErrors(
        residual=ResidualTorque(_RESIDUAL_N_M, SHAPES[seed % len(SHAPES)], kick_n_m_s=5e-4),
        stated_inertia=(roll, pitch, yaw),
        slowest_uplink_s=float(np.exp(rng.uniform(*np.log((60.0, 900.0))))),
    )
    return Scenario(
        "plant_varied",
        "By the seed: shape and size of an unknown torque, inertia 10 % wrong, rows of 10 to 300 s, 30 to 900 s up.",
        row_period_s=ROWS_S[seed // len(SHAPES) % len(ROWS_S)],
        keeping=keeping,
        operation_h=24.0,
    )


CLOSED: tuple[Scenario, ...] = (
    Scenario(
        "slew_fade",
        "Roll and pitch begin 0.35 deg off; 20 min into the slew to zero all carriers fade by 2 dB for an hour.",
        keeping=KeepingErrors(alignment_deg=(0.0, SLEW_DEG, SLEW_DEG)),
        operation_h=12.0,
        faults=(events.DownlinkRain("downlink rain", (1.0 / 3.0, 1.0 / 3.0), (2.0, 2.0), (0.3, 0.3), (60.0, 60.0)),),
    ),
    Scenario(
        "unknown_residual_constant",
        "A constant torque of 2e-7 to 2e-6 N m about each axis is not fed forward, and the catalogue does not know.",
        keeping=KeepingErrors(residual=ResidualTorque(_RESIDUAL_N_M)),
        operation_h=24.0,
    ),
    Scenario(
        "unknown_residual_daily",
        "As unknown_residual_constant; the torque about each axis is a wave of one day.",
        keeping=KeepingErrors(residual=ResidualTorque(_RESIDUAL_N_M, "daily")),
        operation_h=24.0,
    ),
    plant_varied(1),
)


#: the carriers of the default plan
ALL16 = tuple(f"c{number:02d}" for number in range(16))
#: attitude kept closely enough for an announced tour to stay within 0.42 deg
_CLOSE_KEEPING = KeepingErrors(knowledge_deg=(0.018, 0.012, 0.014), feedback_tau_s=0.5 * 3600.0, scale_error=0.01)
_TOUR = events.Tour("tour")


def downlink_rain(
    slope_db_min: float, depth_db: float, duration_min: float = 60.0, name: str = "downlink_rain"
) -> Scenario:
    """Return two days with one rain over the receiving site of this slope and depth."""
    rain = events.DownlinkRain(
        "downlink rain",
        depth_db=(depth_db, depth_db),
        slope_db_min=(slope_db_min, slope_db_min),
        duration_min=(duration_min, duration_min),
    )
    summary = f"Rain over the receiving site: all carriers fade by {depth_db:g} dB at {slope_db_min:g} dB/min."
    return Scenario(name, summary, faults=(rain,))


#: slope, dB/min, and depth, dB, of the rains in the catalogue beside the plain one
_RAINS = ((0.02, 2.0), (0.05, 3.0), (0.3, 4.0), (1.0, 5.0), (3.0, 6.0))

PLAIN: tuple[Scenario, ...] = (
    Scenario("nominal", "Two days of ordinary keeping, no fault."),
    Scenario(
        "demo",
        "A tour of all octants by 0.2-0.33 deg with mild uplink rain and one carrier off for some hours.",
        keeping=_CLOSE_KEEPING,
        manoeuvres=(_TOUR,),
        faults=(
            events.UplinkRain(
                "mild rain",
                3,
                ("c02", "c07", "c13"),
                depth_db=(1.0, 2.5),
                slope_db_min=(0.05, 0.3),
                start_h=(3.0, 40.0),
            ),
            events.SwitchOff("carrier off", ("c05",), start_h=(12.0, 14.0), duration_h=(4.0, 6.0)),
        ),
    ),
    Scenario(
        "octants",
        "A tour of all octants by 0.1-0.4 deg, no fault.",
        keeping=_CLOSE_KEEPING,
        manoeuvres=(replace(_TOUR, yaw_deg=(0.1, 0.4), roll_deg=(0.1, 0.4), pitch_deg=(0.1, 0.4)),),
    ),
    Scenario("steps", "Six users change their level for good.", faults=(events.Step("steps", 6),)),
    Scenario("uplink_rain", "Ten showers over users' stations.", faults=(events.UplinkRain("showers", 10),)),
    downlink_rain(0.1, 3.0),
    *(downlink_rain(slope, depth, name=f"downlink_rain_{slope:g}".replace(".", "p")) for slope, depth in _RAINS),
    Scenario(
        "mixed",
        "Four days with every kind of fault.",
        operation_h=96.0,
        faults=(
            events.UplinkRain("showers", 8, start_h=(1.0, 94.0)),
            events.DownlinkRain("downlink rain", (20.0, 40.0), (1.5, 5.0), (0.03, 0.5), (30.0, 150.0)),
            events.Step("steps", 4, start_h=(1.0, 94.0)),
            events.SwitchOff("carrier off", start_h=(10.0, 80.0), level_after_db=(-1.0, 1.5)),
            events.GroupStep("transponder", start_h=(45.0, 70.0)),
            events.ChainStep("recalibration", (75.0, 85.0), (-0.6, 0.6)),
            events.Interference("interference", 2, start_h=(1.0, 90.0)),
            events.Gap("gap", 2, start_h=(5.0, 90.0)),
        ),
    ),
    Scenario(
        "white",
        "White noise only, of the sizes of the plan; no drift of the chain.",
        noise=NoiseStatistics(
            coloured_db=(0.0, 0.0), chain_db=0.0, chain_daily_db=0.0, thermal_db=0.0, wander_scale=0.0
        ),
    ),
    Scenario("gaps", "Six gaps of ten minutes to three hours.", faults=(events.Gap("gaps", 6),)),
    Scenario("few8", "Eight carriers, no fault.", plan="ku8"),
    Scenario("many32", "Thirty-two carriers, no fault.", plan="ku32"),
    Scenario(
        "steps_heavy",
        "Three days in which each of the sixteen users changes the level for good, once.",
        operation_h=72.0,
        faults=(events.Step("steps", 16, ALL16, start_h=(1.0, 70.0)),),
    ),
    Scenario(
        "downlink_slow",
        "Two slow rains over the receiving site, 0.02 and 0.03 dB/min, hours long.",
        faults=(
            events.DownlinkRain("drizzle", (5.0, 7.0), (1.5, 2.0), (0.02, 0.02), (60.0, 120.0)),
            events.DownlinkRain("long rain", (26.0, 29.0), (2.0, 3.0), (0.03, 0.03), (60.0, 120.0)),
        ),
    ),
    Scenario(
        "downlink_slew",
        "Rain over the receiving site while the spacecraft slews by 0.3 deg, once out and once back.",
        keeping=_CLOSE_KEEPING,
        manoeuvres=(
            events.Hold(8.0, 6.0, 60.0, yaw_deg=0.2, roll_deg=-0.3, pitch_deg=0.25),
            events.Hold(26.0, 6.0, 60.0, yaw_deg=-0.2, roll_deg=0.25, pitch_deg=-0.3),
        ),
        faults=(
            events.DownlinkRain("rain on the way out", (8.1, 8.5), (2.0, 4.0), (0.05, 0.2), (30.0, 60.0)),
            events.DownlinkRain("rain on the way back", (32.1, 32.5), (2.0, 4.0), (0.05, 0.2), (30.0, 60.0)),
        ),
    ),
    Scenario(
        "dual_band",
        "Eight carriers in Ku and eight in C band, which feels a tenth of the rain; one rain over the receiving site.",
        plan="kuc16",
        faults=(events.DownlinkRain("downlink rain", (8.0, 20.0), (2.5, 4.0), (0.05, 0.3), (60.0, 90.0)),),
    ),
    Scenario(
        "transponder",
        "Four steps of gain, each of a whole transponder; one of them is undone after six hours.",
        faults=(
            events.GroupStep("gain 1", start_h=(3.0, 9.0)),
            events.GroupStep("gain 2", start_h=(13.0, 19.0), duration_h=6.0),
            events.GroupStep("gain 3", start_h=(26.0, 32.0)),
            events.GroupStep("gain 4", start_h=(36.0, 44.0)),
        ),
    ),
    Scenario(
        "drift",
        "The receiving chain drifts by some 0.25 dB and is recalibrated four times by 0.2-0.6 dB.",
        noise=NoiseStatistics(chain_db=0.25),
        faults=(
            events.ChainStep("recalibration 1", (4.0, 9.0), (0.2, 0.6)),
            events.ChainStep("recalibration 2", (14.0, 20.0), (-0.6, -0.2)),
            events.ChainStep("recalibration 3", (25.0, 31.0), (-0.6, -0.2)),
            events.ChainStep("recalibration 4", (36.0, 43.0), (0.2, 0.6)),
        ),
    ),
    Scenario(
        "maneuver",
        "A planned burn turns the plane of the orbit; its ephemeris is there at once, the attitude is not disturbed.",
        burns=(events.Burn("station keeping", (10.0, 16.0), ephemeris_after_h=0.0),),
    ),
    Scenario("long14", "Fourteen days of ordinary keeping, no fault.", operation_h=14 * 24.0),
    Scenario(
        "init_bias",
        "Aligned while the spacecraft stands at 0.25/0.16/0.13 deg instead of zero.",
        keeping=KeepingErrors(alignment_deg=(0.25, 0.16, 0.13)),
    ),
    Scenario(
        "interference", "Eight narrow signals inside carriers' bands.", faults=(events.Interference("signals", 8),)
    ),
    Scenario(
        "mixed32",
        "Four days with every kind of fault on thirty-two carriers.",
        operation_h=96.0,
        plan="ku32",
        faults=(
            events.UplinkRain("showers", 16, start_h=(1.0, 94.0)),
            events.DownlinkRain("downlink rain", (20.0, 40.0), (1.5, 5.0), (0.03, 0.5), (30.0, 150.0)),
            events.Step("steps", 8, start_h=(1.0, 94.0)),
            events.SwitchOff("carrier off", start_h=(10.0, 80.0), level_after_db=(-1.0, 1.5)),
            events.SwitchOff("another off", start_h=(10.0, 80.0), level_after_db=(-1.0, 1.5)),
            events.GroupStep("transponder", start_h=(45.0, 70.0)),
            events.ChainStep("recalibration", (75.0, 85.0), (-0.6, 0.6)),
            events.Interference("interference", 4, start_h=(1.0, 90.0)),
            events.Gap("gap", 2, start_h=(5.0, 90.0)),
        ),
    ),
)


#: the three that stay when all others leave: one far in the west, one north, one far in the east
_STAYING = ("c01", "c10", "c14")

SOURCES_OF_REALITY: tuple[Scenario, ...] = (
    Scenario(
        "beacons",
        "Two beacons of the satellite beside sixteen users; rain over the receiving site and a step of the chain.",
        plan="ku16_beacons",
        faults=(
            events.DownlinkRain("downlink rain", (8.0, 20.0), (2.5, 4.0), (0.05, 0.3), (60.0, 90.0)),
            events.ChainStep("recalibration", (30.0, 38.0), (0.4, 0.8)),
        ),
    ),
    Scenario(
        "sensors",
        "No star tracker: an Earth sensor tells roll and pitch, a radio beacon yaw, 20 min of each hour.",
        sensors=(EARTH_SENSOR, RADIO_BEACON),
    ),
    Scenario(
        "prime_backup",
        "For some hours the backup analyzer measures; its receiving chain has 0.4 dB less gain.",
        faults=(events.SourceSwitch("backup", (14.0, 16.0), (6.0, 8.0)),),
    ),
    Scenario(
        "replan",
        "A new plan in mid-operation: two carriers gone, two new, the order turned round.",
        plan="ku16_changed",
        faults=(events.PlanChange("new plan", 20.0, gone=("c06", "c13"), new=("c16", "c17"), is_order_reversed=True),),
    ),
    Scenario(
        "blackout",
        "All carriers leave the air for three hours; later nothing is measured for five.",
        faults=(
            events.SwitchOff("all off", ALL16, (8.0, 10.0), (3.0, 3.0)),
            events.Gap("no analyzer", 1, (26.0, 30.0), (300.0, 300.0)),
        ),
    ),
    Scenario(
        "few3",
        "For six hours only three carriers are on the air.",
        faults=(
            events.SwitchOff(
                "most off", tuple(name for name in ALL16 if name not in _STAYING), (10.0, 12.0), (6.0, 6.0)
            ),
        ),
    ),
    Scenario(
        "corrections_late",
        "As nominal; the ground is told of each correction half an hour after its end.",
        keeping=KeepingErrors(corrections_late_min=30.0),
    ),
    Scenario(
        "antenna_wave",
        "From the start of operation on the Sun moves the uplink patterns by 0.03 and 0.02 deg once a day.",
        faults=(events.PatternWave("bent reflector"),),
    ),
)
