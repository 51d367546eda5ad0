"""Ballistics: burns of the orbit, and which ephemeris the ground has from when.

A burn leaves the satellite where it is, so the inclination vector changes along the direction to the satellite; of the
two senses the one is taken that makes the inclination smaller. Until the new ephemeris comes the old one is void.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from analyzer_sim.epochs import US_PER_DAY, US_PER_H, US_PER_S
from analyzer_sim.streams import stream
from analyzer_sim.world.orbit import Impulse, Orbit
from analyzer_sim.world.payload.effects import NOTICE_H, Operation, draw
from analyzer_sim.world.scenario.events import Burn
from analyzer_sim.world.scenario.story import Scenario
from analyzer_sim.world.spacecraft.telemetry import unloadings_us


@dataclass(frozen=True)
class Ephemeris:
    """One ephemeris of the ground."""

    #: epoch from which the ground has it
    reported_us: int
    #: the orbit that it predicts, up to a small error drawn from the stream of this name
    orbit: Orbit
    stream_name: str
    start_us: int
    stop_us: int

    @property
    def nodes_us(self) -> list[int]:
        """Ascending nodes of its span."""
        return self.orbit.ascending_nodes_us(self.start_us, self.stop_us)

    @property
    def nodal_period_s(self) -> float:
        """Mean time between the nodes after the newest burn, s."""
        burns_us = [impulse.epoch_us for impulse in self.orbit.impulses]
        nodes_us = self.nodes_us
        after_us = [node for node in nodes_us if not burns_us or node > burns_us[-1]]
        return float(np.mean(np.diff(after_us if len(after_us) > 1 else nodes_us))) / US_PER_S


def burnt_orbit(scenario: Scenario, seed: int, orbit: Orbit) -> Orbit:
    """Return the true orbit with all burns of the story."""
    for burn in scenario.burns:
        orbit = replace(orbit, impulses=(*orbit.impulses, _impulse(burn, seed, orbit, scenario.operation_start_us)))
    return orbit


def _impulse(burn: Burn, seed: int, orbit: Orbit, start_us: int) -> Impulse:
    rng = stream(seed, "burn", burn.name)
    start_h, size_deg, drift_deg_day = (draw(rng, r) for r in (burn.start_h, burn.inclination_deg, burn.drift_deg_day))
    drift_sign = float(rng.choice([-1.0, 1.0]))
    epoch_us = start_us + round((start_h + burn.duration_min / 120.0) * 3600.0) * US_PER_S
    here = np.array([epoch_us])
    angle = float(orbit.right_ascension_rad(here)[0])
    ix, iy = (float(component[0]) for component in orbit.inclination_vector_deg(here))
    sense = -1.0 if ix * math.cos(angle) + iy * math.sin(angle) > 0.0 else 1.0
    change = sense * size_deg * math.cos(angle), sense * size_deg * math.sin(angle)
    return Impulse(epoch_us, change, drift_sign * drift_deg_day)


def ephemerides(scenario: Scenario, orbit: Orbit) -> tuple[Ephemeris, ...]:
    """Return every ephemeris of the story in order of time; the first is there before the first row."""
    stop_us = scenario.stop_us + US_PER_DAY
    before = replace(orbit, impulses=())
    reported = [Ephemeris(scenario.start_us, before, "track", scenario.start_us - US_PER_DAY, stop_us)]
    if scenario.pause_h > 0.0:
        start_us = scenario.phase("alignment").start_us
        reported.append(Ephemeris(start_us, before, "track after the pause", start_us - US_PER_DAY, stop_us))
    for number, burn in enumerate(scenario.burns):
        after = replace(orbit, impulses=orbit.impulses[: number + 1])
        burnt_us = after.impulses[-1].epoch_us
        reported_us = burnt_us + round(burn.ephemeris_after_h * US_PER_H)
        reported.append(Ephemeris(reported_us, after, f"track after {burn.name}", burnt_us - US_PER_DAY, stop_us))
    return tuple(sorted(reported, key=lambda ephemeris: ephemeris.reported_us))


def burn_operations(burns: Sequence[Burn], orbit: Orbit) -> list[Operation]:
    """Return what the ground declares about the burns."""
    operations = []
    for burn, impulse in zip(burns, orbit.impulses, strict=True):
        half_us = round(burn.duration_min * 30.0) * US_PER_S
        start_us, stop_us = impulse.epoch_us - half_us, impulse.epoch_us + half_us
        operations.append(
            Operation(
                "station_keeping",
                start_us,
                stop_us,
                start_us - round(NOTICE_H * US_PER_H),
                inhibit_control=True,
                attitude_uncertainty_deg=burn.attitude_uncertainty_deg,
                comment=f"ephemeris void until {burn.ephemeris_after_h:g} h after the burn"
                if burn.ephemeris_after_h > 0.0
                else "new ephemeris at once",
            )
        )
    return operations


def unloading_operations(scenario: Scenario) -> list[Operation]:
    """Return what the ground declares about the unloadings of the wheels: all that leave no impulse behind."""
    is_reported = scenario.wheels is None or scenario.wheels.is_unloading_marked
    if not is_reported or (scenario.keeping.residual is not None and scenario.keeping.residual.kick_n_m_s):
        return []
    return [
        Operation(
            "momentum_unloading",
            epoch_us,
            epoch_us + US_PER_H // 2,
            epoch_us - US_PER_H,
            attitude_uncertainty_deg=(0.0, 0.0, 0.0),
            comment="the loop on board takes it up",
        )
        for epoch_us in unloadings_us(scenario).tolist()
    ]
