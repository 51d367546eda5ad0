"""Uplink: the way of a schedule to the spacecraft, and what the spacecraft makes of it."""

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import NamedTuple

from analyzer_sim.epochs import US_PER_S
from analyzer_sim.streams import stream
from analyzer_sim.world.spacecraft.body import MOMENTUM_LIMIT_N_M_S, QUANTUM_N_M, TorqueElement, Triple

#: natural frequency of the loop, rad/s, and damping
_LOOP_RAD_S, _DAMPING = 2.0 * math.pi / 2400.0, 0.9
#: share of what a product corrects in the angles, and in the bias, 1/s
_ANGLE_GAIN, _BIAS_GAIN_1_S = 0.1, 4e-5
#: rows of the past whose angles are remembered, and the shortest pulse, s
_PAST_ANGLES, _SHORTEST_S = 10, 0.1
_AXES = 3


class Angles(NamedTuple):
    """A product of the ground; yaw, roll, pitch, NaN about an axis that the ground withholds."""

    counter: int
    epoch_us: int
    valid_until_us: int
    attitude_deg: Triple


@dataclass(slots=True)
class AnglesLoop:
    """State of the loop; triples in the order yaw, roll, pitch."""

    inertia_kg_m2: Triple
    #: at which roll and yaw exchange, rad/s
    exchange_rad_s: float
    age_limit_s: float
    angles_deg: list[float] = field(default_factory=lambda: [0.0] * _AXES)
    bias_deg_s: list[float] = field(default_factory=lambda: [0.0] * _AXES)
    newest: Angles | None = None
    _past: dict[int, tuple[float, ...]] = field(default_factory=dict)

    def consume(self, reported: Angles, now_us: int) -> None:
        """Correct the estimate by a product, or leave it out: one that came before, is over, or is too old to place."""
        is_new = self.newest is None or reported.counter > self.newest.counter
        if not is_new or now_us >= reported.valid_until_us:
            return
        before = reported.attitude_deg if self.newest is None else self._past.get(reported.epoch_us)
        if before is None:
            return
        if self.newest is None:
            self.angles_deg = [0.0 if math.isnan(angle) else angle for angle in reported.attitude_deg]
        self.newest = reported
        for k in range(_AXES):
            if math.isnan(reported.attitude_deg[k]):
                continue
            missed = reported.attitude_deg[k] - before[k]
            self.angles_deg[k] += _ANGLE_GAIN * missed
            self.bias_deg_s[k] += _BIAS_GAIN_1_S * missed

    def is_holding(self, now_us: int) -> bool:
        """Return whether the newest product is older than the limit, or none has come."""
        # a limit that is no number is never kept
        return self.newest is None or not now_us - self.newest.epoch_us <= self.age_limit_s * US_PER_S

    def command(self, span_us: tuple[int, int], rate_deg_s: Triple) -> tuple[TorqueElement, ...]:
        """Return the pulses of a span under the rate that torques have given, and carry the angles on to its end."""
        start_us, stop_us = span_us
        span_s = (stop_us - start_us) / US_PER_S
        yaw, roll, _ = self.angles_deg
        exchange = (-self.exchange_rad_s * roll, self.exchange_rad_s * yaw, 0.0)
        rates = [r + b + x for r, b, x in zip(rate_deg_s, self.bias_deg_s, exchange, strict=True)]
        pulses: list[TorqueElement] = []
        if self.newest is not None:
            is_holding = self.is_holding(start_us)
            for k, (angle, rate, inertia) in enumerate(zip(self.angles_deg, rates, self.inertia_kg_m2, strict=True)):
                # what the ground withholds is not turned anywhere, but kept from turning
                stiffness = 0.0 if is_holding or math.isnan(self.newest.attitude_deg[k]) else _LOOP_RAD_S**2
                wanted = stiffness * angle + 2.0 * _DAMPING * _LOOP_RAD_S * rate
                pulses += _pulse(start_us, span_s, k, -inertia * math.radians(wanted))
        self._past[start_us] = tuple(self.angles_deg)
        self._past = dict(list(self._past.items())[-_PAST_ANGLES:])
        self.angles_deg = [angle + rate * span_s for angle, rate in zip(self.angles_deg, rates, strict=True)]
        return tuple(pulses)


def _pulse(start_us: int, span_s: float, axis: int, torque_n_m: float) -> list[TorqueElement]:
    """Return the pulse of whole quanta that gives the impulse of a mean torque; none where it would be too short."""
    quanta = max(1, math.ceil(abs(torque_n_m) / QUANTUM_N_M))
    duration_s = abs(torque_n_m) * span_s / (quanta * QUANTUM_N_M)
    if duration_s < _SHORTEST_S:
        return []
    torque = [0.0] * _AXES
    torque[axis] = math.copysign(quanta * QUANTUM_N_M, torque_n_m)
    yaw, roll, pitch = torque
    return [TorqueElement(start_us, start_us + round(duration_s * US_PER_S), (yaw, roll, pitch))]


#: commands whose begin is kept for older ones that may still come
_REMEMBERED = 16


class UplinkSettings(NamedTuple):
    """Latency, loss and repetition of commands on an uplink channel."""

    latency_s: tuple[float, float]
    lost_share: float
    repeated_share: float

    def within(self, slowest_s: float) -> "UplinkSettings":
        """Return the channel with another slowest way, where it has any latency."""
        return self._replace(latency_s=(self.latency_s[0], slowest_s)) if self.latency_s[1] else self


#: channels by name
UPLINKS: dict[str, UplinkSettings] = {
    "ideal": UplinkSettings((0.0, 0.0), 0.0, 0.0),
    "link": UplinkSettings((30.0, 120.0), 0.02, 0.01),
}


class Fate(StrEnum):
    """Outcome of a command that arrived."""

    EXECUTED = "executed"
    EXECUTING = "executing"
    REPLACED = "replaced"
    REPEATED = "repeated"
    LATE = "late"
    REFUSED = "refused"


class Command(NamedTuple):
    """A schedule under its counter."""

    counter: int
    elements: tuple[TorqueElement, ...]


class Arrival(NamedTuple):
    """A command at the spacecraft."""

    received_us: int
    command: Command
    #: for the loop on board, in place of a command
    angles: Angles | None = None


class Report(NamedTuple):
    """Telemetry report of the spacecraft on one command."""

    reported_us: int
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

    figures: UplinkSettings
    seed: int
    _sent: int = 0
    _under_way: list[Arrival] = field(default_factory=list)

    def send(self, command: Command, sent_us: int, angles: Angles | None = None) -> None:
        """Hand a command, or angles, to the channel."""
        self._sent += 1
        rng = stream(self.seed, "uplink", str(self._sent))
        is_lost = rng.uniform() < self.figures.lost_share
        copies = 2 if rng.uniform() < self.figures.repeated_share else 1
        latencies_s = rng.uniform(*self.figures.latency_s, size=2)[:copies]
        if not is_lost:
            self._under_way += [Arrival(sent_us + round(s * US_PER_S), command, angles) for s in latencies_s.tolist()]

    def arrivals(self, before_us: int) -> list[Arrival]:
        """Return what arrives before an epoch, in order, and forget it."""
        here = sorted((a for a in self._under_way if a.received_us < before_us), key=lambda a: a.received_us)
        self._under_way = [a for a in self._under_way if a.received_us >= before_us]
        return here


@dataclass(slots=True)
class _Accepted:
    """A command that is carried out."""

    arrival: Arrival
    elements: tuple[TorqueElement, ...]
    #: where the first element begins as it was sent; None = there was none
    start_us: int | None
    #: elements whose end has been told
    reported: int = 0

    @property
    def counter(self) -> int:
        return self.arrival.command.counter


@dataclass(slots=True)
class CommandStore:
    """The commands on board."""

    #: torques are rounded to whole multiples of it, N m; 0 = torques of any size act
    quantum_n_m: float = QUANTUM_N_M
    _known: set[int] = field(default_factory=set)
    _executing: list[_Accepted] = field(default_factory=list)
    #: counter and begin of commands that take the place of older ones, as far as older ones may still come
    _begun: dict[int, int] = field(default_factory=dict)

    def receive(self, arrival: Arrival, momentum_n_m_s: Triple) -> tuple[Report | None, tuple[TorqueElement, ...]]:
        """Return what is told at once and the elements to fly; momentum of the wheels as yaw, roll, pitch."""
        received_us, command = arrival.received_us, arrival.command
        fate = self._refusal(arrival, momentum_n_m_s)
        self._known.add(command.counter)
        if fate is not None:
            return Report(received_us, command.counter, fate, received_us), ()
        elements = tuple(_in_quanta(element, self.quantum_n_m) for element in command.elements)
        start_us = min((element.start_us for element in elements), default=None)
        for counter, begin_us in self._begun.items():
            if counter > command.counter:
                elements = _until(elements, begin_us)
        if start_us is not None:
            # the oldest is forgotten: no command comes later than so many younger ones
            self._begun = dict([*self._begun.items(), (command.counter, start_us)][-_REMEMBERED:])
            for older in self._executing:
                if older.counter < command.counter:
                    older.elements = _until(older.elements, start_us)
        self._executing.append(_Accepted(arrival, elements, start_us))
        return None, elements

    def acting(self, from_us: int) -> list[TorqueElement]:
        """Return the elements of all commands that have not ended by an epoch."""
        return [e for accepted in self._executing for e in accepted.elements if e.stop_us > from_us]

    def ended(self, until_us: int) -> list[Report]:
        """Return what is told of commands by an epoch: those that have ended, and what has ended of the others."""
        reports, left = [], []
        for accepted in self._executing:
            over = tuple(element for element in accepted.elements if element.stop_us <= until_us)
            if len(over) == len(accepted.elements):
                reports.append(_end_report(accepted, until_us))
                continue
            left.append(accepted)
            is_between = all(element.start_us >= until_us for element in accepted.elements if element not in over)
            if len(over) > accepted.reported and is_between:
                accepted.reported = len(over)
                reports.append(_report(accepted, over, Fate.EXECUTING))
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


def _end_report(accepted: _Accepted, until_us: int) -> Report:
    """Return the report of a command of which nothing lies ahead."""
    if accepted.elements or accepted.start_us is None:
        return _report(accepted, accepted.elements, Fate.EXECUTED)
    received_us = accepted.arrival.received_us
    return Report(until_us, accepted.counter, Fate.REPLACED, received_us)


def _report(accepted: _Accepted, elements: tuple[TorqueElement, ...], fate: Fate) -> Report:
    received_us = accepted.arrival.received_us
    start_us = min((element.start_us for element in elements), default=received_us)
    stop_us = max((element.stop_us for element in elements), default=received_us)
    return Report(stop_us, accepted.counter, fate, received_us, (start_us, stop_us), impulse_of(elements))


def _until(elements: tuple[TorqueElement, ...], stop_us: int) -> tuple[TorqueElement, ...]:
    """Return what of some elements comes before an epoch."""
    return tuple(replace(e, stop_us=min(e.stop_us, stop_us)) for e in elements if e.start_us < stop_us)


def _in_quanta(element: TorqueElement, quantum_n_m: float) -> TorqueElement:
    if not quantum_n_m:
        return element
    yaw, roll, pitch = (round(torque / quantum_n_m) * quantum_n_m for torque in element.torque_n_m)
    return TorqueElement(element.start_us, element.stop_us, (yaw, roll, pitch))
