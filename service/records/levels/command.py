"""Level L5: torque command. Torque is the torque on the body about roll, pitch, yaw; wheel torque is apart."""

from dataclasses import dataclass
from typing import Annotated

from service.records.epoch import US_PER_S
from service.records.levels.attitude import Axes


@dataclass(frozen=True, slots=True)
class Pulse:
    """One element of a schedule; it ends by itself."""

    start_us: int
    duration_s: float
    #: N m on the body
    torque_n_m: Axes

    @property
    def stop_us(self) -> int:
        """When it ends."""
        return self.start_us + round(self.duration_s * US_PER_S)


@dataclass(frozen=True, slots=True)
class ScheduleVerdict:
    """Verdict of the flexible modes on a schedule, the worst of the axes."""

    #: accept, warn or reject
    verdict: Annotated[str, "A rejected schedule is not released."]
    peak_deg: Annotated[float, "Peak angle that the panels add to the hub, over +-15 % of each frequency."]
    residual_deg: Annotated[float, "Amplitude of the oscillation after the last pulse."]
    margin: Annotated[float, "Share of the allowed peak that is left; negative: exceeded."]
    worst_mode: Annotated[int, "Place among the modes of the catalogue, from 0."]
    suggestion: Annotated[str | None, "Better schedule; null where nothing is wrong or nothing helps."]


@dataclass(frozen=True, slots=True)
class TorqueCommand:
    """Torque command of the chain for the wheels from ``epoch_us`` on, for one command period."""

    epoch_us: int
    #: journal number of the measurement it was computed from
    number: int
    attitude_epoch_us: Annotated[int, "Epoch of the attitude row that it follows from; advances with every row."]
    #: ground, onboard or off
    mode: str
    #: N m, impulse over command period
    torque_n_m: Axes
    #: (W,) N m, mean command to each wheel
    wheels_n_m: tuple[float, ...]
    saturated: bool
    command_period_s: Annotated[float, "Expected time to the next command."]
    valid_until_us: int
    schedule: Annotated[
        tuple[Pulse, ...],
        "Elements inside [epoch, epoch + command_period_s); after the last the torque is zero.",
    ]
    impulse_n_m_s: Axes
    predicted_angle_change_deg: Axes
    predicted_rate_change_deg_s: Axes
    #: (W,) N m s, change of stored momentum of each wheel
    predicted_wheel_momentum_n_m_s: tuple[float, ...]
    control_allowed: bool
    inhibitions: tuple[str, ...]
    #: None: the catalogue knows no flexible mode, or nothing is commanded
    schedule_check: ScheduleVerdict | None = None


@dataclass(frozen=True, slots=True)
class AppliedCommand:
    """A command that counts as applied; known input of the filter."""

    command: TorqueCommand

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return str(self.command.number)


@dataclass(frozen=True, slots=True)
class ReleasedCommand:
    """A command that persons released: until it is reported its whole effect is uncertain."""

    #: rises by one with each command of a spacecraft; the uplink product carries it
    counter: int
    released_us: int
    schedule: tuple[Pulse, ...]

    @property
    def stop_us(self) -> int:
        """When its last pulse ends."""
        return max((pulse.stop_us for pulse in self.schedule), default=self.released_us)

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return str(self.counter)


@dataclass(frozen=True, slots=True)
class ReportedCommand:
    """Report of the centre on a released command: known input of the filter from now on."""

    counter: int
    reported_us: int
    #: executed pulses; empty = none
    executed: tuple[Pulse, ...]

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return str(self.counter)
