"""Catalogue, fourth part: what measures and what is told: beacons, other sensors, two analyzers, new plans, silence."""

from analyzer_sim.world.scenario.catalogue_plain import ALL16
from analyzer_sim.world.scenario.events import (
    ChainStep,
    DownlinkRain,
    Gap,
    PatternWave,
    PlanChange,
    SourceSwitch,
    SwitchOff,
)
from analyzer_sim.world.scenario.story import KeepingErrors, Scenario
from analyzer_sim.world.sensors import EARTH_SENSOR, RADIO_BEACON

#: the three that stay when all others leave: one far in the west, one north, one far in the east
_STAYING = ("c01", "c10", "c14")

SOURCES_OF_REALITY: tuple[Scenario, ...] = (
    Scenario(
        "beacons",
        "Two beacons of the satellite beside sixteen users; rain over the receiving site and a step of the chain.",
        plan="ku16_beacons",
        faults=(
            DownlinkRain("downlink rain", (8.0, 20.0), (2.5, 4.0), (0.05, 0.3), (60.0, 90.0)),
            ChainStep("recalibration", (30.0, 38.0), (0.4, 0.8)),
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
        faults=(SourceSwitch("backup", (14.0, 16.0), (6.0, 8.0)),),
    ),
    Scenario(
        "replan",
        "A new plan in mid-operation: two carriers gone, two new, the order turned round.",
        plan="ku16_changed",
        faults=(PlanChange("new plan", 20.0, gone=("c06", "c13"), new=("c16", "c17"), is_order_reversed=True),),
    ),
    Scenario(
        "blackout",
        "All carriers leave the air for three hours; later nothing is measured for five.",
        faults=(
            SwitchOff("all off", ALL16, (8.0, 10.0), (3.0, 3.0)),
            Gap("no analyzer", 1, (26.0, 30.0), (300.0, 300.0)),
        ),
    ),
    Scenario(
        "few3",
        "For six hours only three carriers are on the air.",
        faults=(
            SwitchOff("most off", tuple(name for name in ALL16 if name not in _STAYING), (10.0, 12.0), (6.0, 6.0)),
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
        faults=(PatternWave("bent reflector"),),
    ),
)
