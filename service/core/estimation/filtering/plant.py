"""Carriers and spacecraft as the compiled filter sees them: a few arrays; and the prior of the torques.

    m' = h_const + h_cos cos(p) + h_sin sin(p)           h (9,) as in `step_inputs`, deg/h^2
    P  = diag(residual) + V (c^2 1 + o^2 I) V'           V (9, 3): the profile that is fed forward, axis by axis

The residual is a torque of unknown shape. What is left of a known profile has its shape: a share of it, most of it (c)
common to all axes because one model of the Sun's light made it, a little (o) of each axis' own. Both are Gaussian and
linear in h, so that shares need no states beside the nine: they are a covariance of these, and a share that one axis
shows is known about the others.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray
from service.core.estimation.filtering.filter_model import (
    ORBITAL_RATE_PER_H,
    CarrierModel,
    FedForward,
    FilterSettings,
    RateSensorModel,
    model_error_component,
)

#: states of the torque: a constant, a cosine and a sine an axis
TORQUES = 9
#: states of the wheels: momentum (3), misalignment (2), scales (2)
WHEEL_STATES = 7
#: states of one polarimeter: offset, daily cosine and sine, wander
POLARIMETER = 4
#: place of the wander among them
WANDER = 3
#: the Sun turns round the body once in this time, us
DAY_US = 86_400_000_000

#: settings of a spacecraft; triples in the order yaw, roll, pitch
PLANT = np.dtype(
    [
        ("coupling_per_h", "f8"),
        ("drift_deg_h", "f8", (3,)),
        ("drift_tau_h", "f8"),
        ("correction_scale", "f8"),
        ("correction_span_s", "f8"),
        ("torque_scale", "f8"),
        ("chain_walk_db", "f8"),
        ("rain_wet_db", "f8"),
        ("rain_dry_db", "f8"),
        ("rain_dry_tau_s", "f8"),
        ("unannounced_walk_deg", "f8", (3,)),
        # torques among the states, whether one pushes the body, and how large it is
        ("has_torque", "?"),
        ("is_pushed", "?"),
        ("torque_size_deg_h2", "f8", (3,)),
        ("unknown_torque_deg_h2", "f8", (3,)),
        ("torque_prior_deg_h2", "f8", (TORQUES,)),
        ("torque_tau_h", "f8"),
        ("wave_period_us", "i8"),
        # shares of a profile that is fed forward
        ("is_fed_forward", "?"),
        ("scale_covariance", "f8", (TORQUES, TORQUES)),
        # a rate sensor makes the step
        ("is_rate_measured", "?"),
        ("rate_noise_deg_sqrt_h", "f8"),
        # wheels; a torque of their own gathers in them, or a profile does
        ("has_wheels", "?"),
        ("has_gathered_torque", "?"),
        ("inertia_kg_m2", "f8", (3,)),
        ("momentum_sigma_n_m_s", "f8"),
        ("walk_n_m_s_sqrt_s", "f8"),
        ("gathered_prior_deg_h2", "f8", (TORQUES,)),
        ("profile_deg_h2", "f8", (TORQUES,)),
        # states of other sensors behind the torques
        ("sensor_states", "i8"),
        # limits within which control may use the attitude
        ("sigma_yaw_deg", "f8"),
        ("sigma_roll_deg", "f8"),
        ("sigma_pitch_deg", "f8"),
        ("alert_deg", "f8"),
        ("redundancy", "i8"),
        ("nis_ratio", "f8"),
        ("relearned_share", "f8"),
    ],
    align=True,
)
#: response and noise of a carrier, as in `CarrierModel`
RESPONSE = np.dtype(
    [
        ("gradient_db_deg", "f8", (3,)),
        ("hessian_db_deg2", "f8", (3, 3)),
        ("rain_share", "f8"),
        ("transponder", "i8"),
        ("white_sigma_db", "f8"),
        ("reference_walk_db", "f8"),
        ("coefficient_covariance", "f8", (9, 9)),
        # which coloured part also carries the error of the calibration
        ("error_component", "i8"),
    ],
    align=True,
)
#: noise that all carriers share
SHARED_NOISE = np.dtype([("sigma_db", "f8"), ("tau_s", "f8")], align=True)
#: a polarimeter, as in `PolarimeterModel`, and whether a calibration tells of it
FEED = np.dtype(
    [
        ("sight", "f8", (3,)),
        ("daily_deg", "f8"),
        ("wander_deg", "f8"),
        ("wander_h", "f8"),
        ("offset_walk_deg_sqrt_h", "f8"),
        ("is_learned", "?"),
    ],
    align=True,
)


class IntegrityLimits(NamedTuple):
    """Limits within which control may use the attitude."""

    #: three sigma of yaw stay near the 0.3 deg that make a torque wrong; quiet carriers leave 0.09-0.12, flicker
    #: 0.11-0.13
    sigma_yaw_deg: float = 0.10
    sigma_roll_deg: float = 0.06
    sigma_pitch_deg: float = 0.10
    #: greatest protection level of roll and of pitch, deg
    alert_deg: float = 0.22
    redundancy: int = 2
    #: largest running mean of normalised innovation squared a degree of freedom
    nis_ratio: float = 2.0
    #: share of references learned again above which a new alignment is advised
    relearned_share: float = 1.0 / 3.0


class FilterModel(NamedTuple):
    """Carriers and spacecraft of a filter; nobody may write to the arrays."""

    #: (N,) of `RESPONSE`
    carriers: NDArray[np.void]
    #: (N, K) dB and s
    coloured_sigma_db: FloatArray
    coloured_tau_s: FloatArray
    #: (G,) of `SHARED_NOISE`
    common: NDArray[np.void]
    #: of `PLANT`, (1,) or (2,) with that of a step whose rate a sensor measured; (P,) of `FEED`
    plant: NDArray[np.void]
    feeds: NDArray[np.void]


def filter_model(
    carriers: CarrierModel,
    settings: FilterSettings | None = None,
    limits: IntegrityLimits | None = None,
    rate_sensor: RateSensorModel | None = None,
) -> FilterModel:
    """Return carriers, spacecraft, limits and sensors of motion as the compiled filter takes them."""
    settings, limits = settings or FilterSettings(), limits or IntegrityLimits()
    response = np.zeros(carriers.carriers, RESPONSE)
    for name in carriers._fields:
        if name in (RESPONSE.names or ()):
            response[name] = getattr(carriers, name)
    if carriers.carriers:
        response["error_component"] = model_error_component(carriers.coloured_tau_s)
    common = np.zeros(len(carriers.common_sigma_db), SHARED_NOISE)
    common["sigma_db"], common["tau_s"] = carriers.common_sigma_db, carriers.common_tau_s
    each = [settings] if rate_sensor is None else [settings, measured_settings(settings, rate_sensor)]
    plant, feeds = np.zeros(len(each), PLANT), np.zeros(len(settings.polarimeters), FEED)
    for place, one in enumerate(each):
        _write_plant(plant[place], one, limits)
    for place, polarimeter in enumerate(settings.polarimeters):
        for name in FEED.names or ():
            feeds[name][place] = getattr(polarimeter, name, polarimeter.learned is not None)
    return FilterModel(
        response,
        np.array(carriers.coloured_sigma_db, dtype=np.float64, order="C"),
        np.array(carriers.coloured_tau_s, dtype=np.float64, order="C"),
        common,
        plant,
        feeds,
    )


def measured_settings(settings: FilterSettings, sensor: RateSensorModel) -> FilterSettings:
    """Return the settings of a step whose rate is measured: bias in place of drift, the true exchange."""
    bias = sensor.bias_deg_h
    return settings._replace(
        coupling_per_h=ORBITAL_RATE_PER_H,
        drift_deg_h=(bias, bias, bias),
        drift_tau_h=sensor.bias_tau_h,
        rate_noise_deg_sqrt_h=sensor.noise_deg_sqrt_h,
    )


def _write_plant(plant: np.void, settings: FilterSettings, limits: IntegrityLimits) -> None:
    """Write settings and limits into a record of `PLANT`."""
    wheels = settings.momentum
    for name, value in (*settings._asdict().items(), *limits._asdict().items()):
        if name in (PLANT.names or ()) and value is not None:
            plant[name] = value
    plant["has_torque"], plant["is_pushed"] = has_torque(settings), is_pushed(settings)
    plant["torque_size_deg_h2"] = torque_size_deg_h2(settings)
    plant["torque_prior_deg_h2"] = torque_prior_deg_h2(settings)
    plant["wave_period_us"] = wave_period_us(settings)
    plant["is_rate_measured"] = settings.rate_noise_deg_sqrt_h is not None
    if settings.fed_forward is not None:
        plant["is_fed_forward"], plant["scale_covariance"] = True, scale_covariance(settings.fed_forward)
    if wheels is not None:
        plant["has_wheels"], plant["has_gathered_torque"] = True, momentum_count(settings) > WHEEL_STATES
        plant["inertia_kg_m2"], plant["walk_n_m_s_sqrt_s"] = wheels.inertia_kg_m2, wheels.walk_n_m_s_sqrt_s
        plant["momentum_sigma_n_m_s"] = wheels.sigma_n_m_s
        plant["gathered_prior_deg_h2"] = gathered_prior_deg_h2(settings)
        known = wheels.profile or settings.fed_forward
        plant["profile_deg_h2"] = 0.0 if known is None else np.concatenate(known[:3])
    plant["sensor_states"] = sensor_states(settings)


def momentum_count(settings: FilterSettings) -> int:
    """Return how many states the momentum of the wheels has.

    Where one torque pushes the body and another of unknown profile gathers in the wheels, the nine of that stand last.
    """
    wheels = settings.momentum
    if wheels is None:
        return 0
    return WHEEL_STATES + TORQUES * (wheels.unknown_torque_deg_h2 is not None and is_pushed(settings))


def sensor_states(settings: FilterSettings) -> int:
    """Return the number of hidden states of other sensors, the last ones: the wheels, then each polarimeter."""
    return momentum_count(settings) + POLARIMETER * len(settings.polarimeters)


def wave_period_us(settings: FilterSettings) -> int:
    """Return the time in which the torque goes round: that of the profile known, without one a solar day."""
    known = settings.fed_forward or (None if settings.momentum is None else settings.momentum.profile)
    return DAY_US if known is None else known.period_us


def torque_prior_deg_h2(settings: FilterSettings) -> FloatArray:
    """Return the standard deviation (9,) of the residual torque.

    At every hour the torque has the size that was stated. Who states a size does not state the shape: what pushes is
    the light of the Sun, which goes round, or it stands still. With a fifth constant a constant of twice the size
    leaves yaw wrong by 0.5 deg for a day, with equal parts by 0.3, which is what powers alone allow; one of the size
    let yaw run away to 3 deg in a closed loop, for 0.9.
    """
    if has_torque(settings) and not is_pushed(settings):
        return gathered_prior_deg_h2(settings)
    return _prior(settings.torque_deg_h2)


def gathered_prior_deg_h2(settings: FilterSettings) -> FloatArray:
    """Return the standard deviation (9,) of the torque that gathers in the wheels where no profile is known; else 0."""
    unknown = None if settings.momentum is None else settings.momentum.unknown_torque_deg_h2
    return np.zeros(TORQUES) if unknown is None else _prior(unknown)


def _prior(size_deg_h2: tuple[float, float, float]) -> FloatArray:
    """Return the standard deviation (9,) of a torque of a size, half of its variance constant."""
    return np.tile(math.sqrt(0.5) * np.array(size_deg_h2), 3)


def scale_covariance(reported: FedForward) -> FloatArray:
    """Return the covariance (9, 9) of what is wrong with a profile, (deg/h^2)^2; its rank is three."""
    profile = np.vstack([np.diag(part) for part in reported[:3]])
    shares = np.full((3, 3), reported.relative_error**2) + reported.axis_relative_error**2 * np.eye(3)
    return np.asarray(profile @ shares @ profile.T)


def torque_covariance(settings: FilterSettings) -> FloatArray:
    """Return the covariance (9, 9) of the torque before anything was learned of it, (deg/h^2)^2."""
    covariance = np.diag(torque_prior_deg_h2(settings) ** 2)
    for known in (settings.fed_forward, None if settings.momentum is None else settings.momentum.profile):
        covariance = covariance if known is None else covariance + scale_covariance(known)
    return covariance


def torque_size_deg_h2(settings: FilterSettings) -> FloatArray:
    """Return how large (3,) the torque is thought to be at the most, one sigma, deg/h^2."""
    size = np.array(settings.torque_deg_h2)
    reported = settings.fed_forward
    if reported is None:
        return size
    constant, cosine, sine = np.abs(np.array(reported[:3]))
    share = math.hypot(reported.relative_error, reported.axis_relative_error)
    return np.asarray(np.hypot(size, share * (constant + np.hypot(cosine, sine))))


def is_pushed(settings: FilterSettings) -> bool:
    """Return whether a torque acts that is not fed forward."""
    return float(torque_size_deg_h2(settings).max()) > 0.0


def has_torque(settings: FilterSettings) -> bool:
    """Return whether torques are among the states: one that is not fed forward, or one that gathers in the wheels."""
    wheels = settings.momentum
    is_gathered = wheels is not None and (wheels.profile is not None or wheels.unknown_torque_deg_h2 is not None)
    return is_pushed(settings) or is_gathered
