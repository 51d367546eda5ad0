"""Catalogue: what the ground states about a spacecraft, its carriers and its orbit.

Records are immutable. A carrier plan and an ephemeris are versions: a change makes a new one, rows keep the number of
the one they belong to.
"""

from dataclasses import dataclass
from enum import StrEnum

Matrix3 = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


class Method(StrEnum):
    """Estimation method."""

    ROBUST = "robust"
    PAPER = "paper"
    #: rows of the robust method after the rows that came later: in versions of their own, never for control
    ROBUST_SMOOTHED = "robust_smoothed"


#: methods that run on every row, and of which one may drive control
LIVE_METHODS = (Method.ROBUST, Method.PAPER)


class ControlMode(StrEnum):
    """Place of the torque computation: on the ground, on board, or none."""

    GROUND = "ground"
    ONBOARD = "onboard"
    OFF = "off"


class ControlLaw(StrEnum):
    """Control law: torque from angles and rates."""

    PROPORTIONAL_DERIVATIVE = "proportional_derivative"
    #: yaw follows from the roll rate of the rate sensor on board
    GYRO_ORBITANT = "gyro_orbitant"


class Release(StrEnum):
    """Release mode, by which a computed command becomes an applied one."""

    TWO_STEP = "two_step"
    AUTOMATIC = "automatic"


@dataclass(frozen=True, slots=True)
class Site:
    """The receiving site."""

    #: degrees North, -90..90
    latitude_deg: float
    #: degrees East
    longitude_deg: float
    name: str = ""
    #: metres above the ellipsoid
    height_m: float = 0.0


@dataclass(frozen=True, slots=True)
class WheelSet:
    """Reaction wheels."""

    #: unit vectors of the spin axes in body axes (x roll, y pitch, z yaw)
    axes: tuple[tuple[float, float, float], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    #: greatest torque of one wheel, N m
    torque_limit_n_m: float = 0.05
    #: greatest stored momentum of one wheel, N m s
    momentum_limit_n_m_s: float = 20.0
    #: smallest step of the drive, N m
    torque_quantum_n_m: float = 0.002


@dataclass(frozen=True, slots=True)
class FlexibleMode:
    """One flexible mode, for the schedule check."""

    #: roll, pitch or yaw
    axis: str
    omega_rad_s: float
    damping_ratio: float
    coupling: float


@dataclass(frozen=True, slots=True)
class AxisTorques:
    """A torque on the body about each axis, N m."""

    yaw: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0


@dataclass(frozen=True, slots=True)
class FedForwardTorque:
    """Known torque that the loop on board takes away: a constant and a wave, and how wrong the profile may be."""

    #: where the phase of the wave is zero
    epoch_us: int
    period_s: float = 86_400.0
    constant_n_m: AxisTorques = AxisTorques()
    cosine_n_m: AxisTorques = AxisTorques()
    sine_n_m: AxisTorques = AxisTorques()
    #: one standard deviation of the share that all axes have wrong together, and of each axis' own
    relative_error: float = 0.06
    axis_relative_error: float = 0.01


@dataclass(frozen=True, slots=True)
class WheelMomentum:
    """Telemetry of the momentum of the wheels as a measurement of attitude."""

    #: noise of a record along an axis, N m s
    sigma_n_m_s: float = 0.01
    #: one standard deviation of the scale, relative, and of the axes, deg
    scale_error: float = 0.005
    misalignment_deg: float = 0.05
    #: momentum along pitch that unloadings restore, N m s, for the check at calibration; None = unknown
    pitch_bias_n_m_s: float | None = None
    #: whether the filter uses it
    used: bool = True
    #: torque from outside that gathers in the wheels and moves nothing else; None = that of fed_forward_torque, whose
    #: error also moves the body; neither stated: an unknown one
    torque: FedForwardTorque | None = None


@dataclass(frozen=True, slots=True)
class BodyRateSensor:
    """Telemetry of the rate of the body as a measurement of its motion."""

    #: whether the loop on board closes on this sensor: what it holds still tells nothing new
    in_loop: bool
    #: bias about an axis, one standard deviation, deg/h, and its correlation time; None = not stated, in the loop
    bias_deg_h: float | None = None
    bias_tau_h: float | None = None
    #: angle random walk, deg/sqrt(h)
    noise_deg_sqrt_h: float | None = None


@dataclass(frozen=True, slots=True)
class Onboard:
    """On-board control of the spacecraft: fast loop, forecast mode, roll-yaw coupling and known torques."""

    #: the fast loop closes on inertial measurements or their model
    fast_loop: bool = False
    #: the on-board Forecast mode takes torques from the ground
    forecast_mode: bool = False
    #: roll and yaw exchange at the orbital rate; None = unknown, as in a request that leaves it out
    roll_yaw_coupling: bool | None = True
    #: size of the disturbance torque an axis that is not fed forward on board, N m; 0 = there is none, None = unknown
    residual_torque_n_m: float | None = 0.0
    #: torque profile fed forward on board; None = none, or unknown
    fed_forward_torque: FedForwardTorque | None = None
    #: None = the filter does not use the momentum of the wheels
    momentum: WheelMomentum | None = None
    #: None = the filter does not use the rates of the body
    rate_sensor: BodyRateSensor | None = None


@dataclass(frozen=True, slots=True)
class GyroOrbitantGains:
    """Gains of the gyro-orbitant law: N m a unit of half-angle, and N m s."""

    roll_stiffness_n_m: float
    roll_damping_n_m_s: float
    pitch_stiffness_n_m: float
    pitch_damping_n_m_s: float
    yaw_stiffness_n_m: float
    yaw_damping_n_m_s: float


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """Attitude control of one spacecraft."""

    method: Method = Method.ROBUST
    mode: ControlMode = ControlMode.GROUND
    release: Release = Release.TWO_STEP
    #: period of the closed loop, s
    period_s: float = 7200.0
    damping: float = 0.9
    #: time between commands under release in two steps, s; under the automatic one it is the time between rows
    command_period_s: float = 900.0
    #: how far the pulses against a known torque of a released command reach at most, s
    forecast_horizon_s: float = 3600.0
    law: ControlLaw = ControlLaw.PROPORTIONAL_DERIVATIVE
    #: of the law gyro_orbitant; it has none without
    gyro_orbitant: GyroOrbitantGains | None = None


@dataclass(frozen=True, slots=True)
class Polarimeter:
    """Polarimeter on the ground as a measurement of attitude: its feed, its place, what its angle has wrong."""

    #: as its records name it
    source: str
    #: turn of the two ports against the polarisation at zero attitude, deg, positive as a positive yaw turns it
    feed_offset_deg: float
    #: of the beacon or carrier measured, Hz
    frequency_hz: float
    #: None = it stands at the receiving site
    site: Site | None = None
    #: component of the Earth's magnetic field along the downlink, T, for the Faraday rotation of a reported content
    field_t: float = 0.0
    #: one standard deviation: white noise of a record, amplitude of a daily wave, wander and its correlation time
    white_deg: float = 0.07
    daily_deg: float = 0.05
    wander_deg: float = 0.05
    wander_h: float = 4.0
    #: walk of the offset, deg/sqrt(h)
    offset_walk_deg_sqrt_h: float = 0.003
    #: whether the filter uses it
    used: bool = True


@dataclass(frozen=True, slots=True)
class Spacecraft:
    """One spacecraft of the catalogue."""

    id: str
    name: str
    #: degrees East of the nominal sub-satellite point
    longitude_deg: float
    receiving_site: Site
    #: tensor elements, kg m^2; x roll, y pitch, z yaw
    inertia_kg_m2: Matrix3
    #: greatest torque on the body an axis, N m
    torque_limit_n_m: float
    cospar_id: str | None = None
    simulated: bool = False
    wheels: WheelSet = WheelSet()
    modes: tuple[FlexibleMode, ...] = ()
    onboard: Onboard = Onboard()
    control: ControlSettings = ControlSettings()
    #: each measures yaw by polarisation
    polarimeters: tuple[Polarimeter, ...] = ()

    def __hash__(self) -> int:
        """Return a number by the id: each row asks for what is designed for its spacecraft."""
        return hash(self.id)


@dataclass(frozen=True, slots=True)
class Station:
    """Earth station that radiates a carrier."""

    latitude_deg: float
    longitude_deg: float
    name: str = ""


@dataclass(frozen=True, slots=True)
class Carrier:
    """One signal of one earth station through one transponder."""

    id: str
    band: str
    transponder: str
    downlink_hz: float
    bandwidth_hz: float
    #: None for a beacon: it has a downlink only
    station: Station | None = None
    uplink_hz: float | None = None
    name: str = ""
    polarization: str | None = None
    #: centre frequency at the analyzer input, Hz
    intermediate_hz: float | None = None
    #: traffic, beacon or pilot
    kind: str = "traffic"
    #: none, auto or unknown; auto is never used for attitude
    uplink_power_control: str = "unknown"
    #: fixed_gain, alc or unknown
    transponder_mode: str = "unknown"
    enabled: bool = True

    @property
    def is_usable_for_attitude(self) -> bool:
        """Return whether the carrier may enter the sensitivity system at all."""
        return self.enabled and self.kind != "beacon" and self.uplink_power_control != "auto"


@dataclass(frozen=True, slots=True)
class CarrierPlan:
    """An immutable, ordered list of carriers; levels of a measurement follow this order."""

    id: int
    sha256: str
    carriers: tuple[Carrier, ...]
    #: no row may come under it any more
    is_withdrawn: bool = False

    @property
    def carrier_ids(self) -> tuple[str, ...]:
        """Carrier ids in the order of the levels."""
        # a list is three times as fast as a generator: each row of powers asks
        return tuple([carrier.id for carrier in self.carriers])


@dataclass(frozen=True, slots=True)
class Track:
    """Predicted sub-satellite point."""

    epochs_us: tuple[int, ...]
    #: degrees North
    latitude_deg: tuple[float, ...]
    #: degrees East, absolute
    longitude_deg: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Ephemeris:
    """One version of the orbit: node passages, nodal period and, where known, the track."""

    id: int
    #: northward crossings of the equator, ascending
    ascending_nodes_us: tuple[int, ...]
    nodal_period_s: float
    valid_start_us: int
    valid_stop_us: int
    #: nodes, tle or oem
    form: str
    track: Track | None = None
