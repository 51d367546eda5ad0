"""Uplink: the way of a schedule to the craft, and what the craft makes of it.

A command arrives some time after it was sent, is lost, or arrives twice; what becomes of the n-th one is drawn from a
stream of its own. On board, in this order:

* a counter that was received before is never executed again, whatever came with it: ``repeated``
* a command of which an element should have begun already is left out as a whole, because the half of a slew leaves a
  rate behind: ``late``
* a command that would bring a wheel to its limit of momentum is left out: ``refused``
* every other one is executed, each torque rounded to whole quanta, and told when it has ended: ``executed``

Commands may overtake one another; the order of counters means nothing. What is lost is not told: no report comes.
"""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

from analyzer_sim.epochs import US_PER_S
from analyzer_sim.streams import stream
from analyzer_sim.world.rigid_body import TorqueElement, Triple
from analyzer_sim.world.wheels import MOMENTUM_LIMIT_N_M_S, QUANTUM_N_M


class UplinkFigures(NamedTuple):
    """What a channel does to commands."""

    latency_s: tuple[float, float]
    lost_share: float
    repeated_share: float


#: channels by name
UPLINKS: dict[str, UplinkFigures] = {
    "ideal": UplinkFigures((0.0, 0.0), 0.0, 0.0),
    "link": UplinkFigures((30.0, 120.0), 0.02, 0.01),
}


class Fate(StrEnum):
    """What became of a command that arrived."""

    EXECUTED = "executed"
    REPEATED = "repeated"
    LATE = "late"
    REFUSED = "refused"


class Command(NamedTuple):
    """A schedule under its counter."""

    counter: int
    elements: tuple[TorqueElement, ...]


class Arrival(NamedTuple):
    """A command at the craft."""

    received_us: int
    command: Command


class Report(NamedTuple):
    """What the craft tells of a command."""

    told_us: int
    counter: int
    fate: Fate
    received_us: int
    #: of the elements that were executed; none = nothing was
    executed_us: tuple[int, int] | None = None
    #: N m s, yaw, roll, pitch
    impulse_n_m_s: Triple = (0.0, 0.0, 0.0)


@dataclass(slots=True)
class Uplink:
    """The channel."""

    figures: UplinkFigures
    seed: int
    _sent: int = 0
    _under_way: list[Arrival] = field(default_factory=list)

    def send(self, command: Command, sent_us: int) -> None:
        """Hand a command to the channel."""
        self._sent += 1
        rng = stream(self.seed, "uplink", str(self._sent))
        is_lost = rng.uniform() < self.figures.lost_share
        copies = 2 if rng.uniform() < self.figures.repeated_share else 1
        latencies_s = rng.uniform(*self.figures.latency_s, size=2)[:copies]
        if not is_lost:
            self._under_way += [Arrival(sent_us + round(s * US_PER_S), command) for s in latencies_s.tolist()]

    def arrivals(self, before_us: int) -> list[Arrival]:
        """Return what arrives before an epoch, in order, and forget it."""
        here = sorted((a for a in self._under_way if a.received_us < before_us), key=lambda a: a.received_us)
        self._under_way = [a for a in self._under_way if a.received_us >= before_us]
        return here


@dataclass(slots=True)
class CommandStore:
    """The commands on board."""

    #: torques are rounded to whole multiples of it, N m; 0 = torques of any size act
    quantum_n_m: float = QUANTUM_N_M
    _known: set[int] = field(default_factory=set)
    _executing: list[tuple[Arrival, tuple[TorqueElement, ...]]] = field(default_factory=list)

    def receive(self, arrival: Arrival, momentum_n_m_s: Triple) -> tuple[Report | None, tuple[TorqueElement, ...]]:
        """Return what is told at once and the elements to fly; momentum of the wheels as yaw, roll, pitch."""
        received_us, command = arrival
        fate = self._refusal(arrival, momentum_n_m_s)
        self._known.add(command.counter)
        if fate is not None:
            return Report(received_us, command.counter, fate, received_us), ()
        elements = tuple(_in_quanta(element, self.quantum_n_m) for element in command.elements)
        self._executing.append((arrival, elements))
        return None, elements

    def ended(self, until_us: int) -> list[Report]:
        """Return the reports of the commands whose last element has ended by an epoch."""
        reports, left = [], []
        for arrival, elements in self._executing:
            stop_us = max((element.stop_us for element in elements), default=arrival.received_us)
            if stop_us > until_us:
                left.append((arrival, elements))
                continue
            start_us = min((element.start_us for element in elements), default=arrival.received_us)
            span_us, impulse = (start_us, stop_us), impulse_of(elements)
            reports.append(
                Report(stop_us, arrival.command.counter, Fate.EXECUTED, arrival.received_us, span_us, impulse)
            )
        self._executing = left
        return reports

    def _refusal(self, arrival: Arrival, momentum_n_m_s: Triple) -> Fate | None:
        """Return why a command is not executed."""
        if arrival.command.counter in self._known:
            return Fate.REPEATED
        if any(element.start_us < arrival.received_us for element in arrival.command.elements):
            return Fate.LATE
        impulse = impulse_of(arrival.command.elements)
        stored = [abs(h - j) for h, j in zip(momentum_n_m_s, impulse, strict=True)]
        return Fate.REFUSED if max(stored) > MOMENTUM_LIMIT_N_M_S else None


def impulse_of(elements: tuple[TorqueElement, ...]) -> Triple:
    """Return the impulse of some elements, N m s, yaw, roll, pitch."""
    yaw, roll, pitch = (
        sum(e.torque_n_m[axis] * (e.stop_us - e.start_us) / US_PER_S for e in elements) for axis in range(3)
    )
    return yaw, roll, pitch


def _in_quanta(element: TorqueElement, quantum_n_m: float) -> TorqueElement:
    if not quantum_n_m:
        return element
    yaw, roll, pitch = (round(torque / quantum_n_m) * quantum_n_m for torque in element.torque_n_m)
    return TorqueElement(element.start_us, element.stop_us, (yaw, roll, pitch))
