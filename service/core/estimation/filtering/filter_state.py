"""State of the attitude filter between two rows: a few arrays.

    x = [yaw roll pitch | 3 drifts | 3 commanded rates | chain | rain | G common parts | E hidden
         | N first components | ... | N last components | N references]

Beside mean and covariance stand one record a carrier, one record of what concerns the spacecraft as a whole, and a few
windows of rows. A state is a value: who takes a row writes into a copy.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray
from service.core.estimation.filtering.filter_model import CarrierModel, Gaussian

#: rows by which a carrier that is set aside is judged, of rain, and minutes of a mean of the anchor
STANDING_ROWS, STEADY_ROWS, ANCHOR_MINUTES = 60, 60, 20
#: figures of integrity that are held against limits
FIGURES = 8
#: epoch of the newest record before the first, microseconds UTC
NEVER_US = -(1 << 62)

#: a carrier
CARRIER = np.dtype(
    [
        ("is_flagged", "?"),
        # whether the reference was learned again since the alignment
        ("is_relearned", "?"),
        # minutes of skips in a row, since the flag, and without the carrier while the others were measured
        ("skip_minutes", "f8"),
        ("flagged_minutes", "f8"),
        ("absent_minutes", "f8"),
        # reference error and its variance before the flag, and by the alignment, which are kept for good; dB, dB^2
        ("saved_reference_db", "f8"),
        ("saved_variance_db2", "f8"),
        ("aligned_reference_db", "f8"),
        ("aligned_variance_db2", "f8"),
        # cumulative sums of the test values
        ("up", "f8"),
        ("down", "f8"),
        # sum and rows of the minute that is not over
        ("minute_total", "f8"),
        ("minute_rows", "f8"),
        # factor on the white sigma, and running mean of the test values
        ("white_scale", "f8"),
        ("running_mean", "f8"),
        # error of the calibration that the state holds, dB^2
        ("model_variance_db2", "f8"),
        # likeliest of `HYPOTHESES`, its probability, NaN before an answer, and since when it is, microseconds UTC
        ("hypothesis", "i8"),
        ("probability", "f8"),
        ("hypothesis_since_us", "i8"),
    ],
    align=True,
)

#: the spacecraft as a whole; (3,) in the order yaw, roll, pitch
WATCH = np.dtype(
    [
        ("epoch_us", "i8"),
        # rain over the receiving site and steps of the receiving chain
        ("is_raining", "?"),
        # the last rain ended as a step of the chain, or stays
        ("is_steady", "?"),
        # minutes in rain mode, of them in a row below the dry limit, and for which control is held after a step up
        ("wet_minutes", "f8"),
        ("dry_minutes", "f8"),
        ("hold_minutes", "f8"),
        # chain gain when the downward sum last was zero, dB
        ("base_chain_db", "f8"),
        ("common_up", "f8"),
        ("common_down", "f8"),
        # rain of the last rows in rain mode, newest last, dB
        ("rain_db", "f8", (STEADY_ROWS,)),
        # the minute that is not over: begin, and the common value
        ("minute_start_us", "i8"),
        ("common_total", "f8"),
        ("common_rows", "f8"),
        # factor on the slow sigmas of all carriers; running mean of normalised innovation squared a degree of freedom
        ("slow_scale", "f8"),
        ("nis_ratio", "f8"),
        # shifts of the attitude, in sigmas
        ("shift_start_us", "i8"),
        ("shift_total", "f8", (3,)),
        ("shift_rows", "f8", (3,)),
        ("shift_up", "f8", (3,)),
        ("shift_down", "f8", (3,)),
        # minutes for which an axis is followed with a wide drift, and for which its motion is reported as unannounced
        ("followed_minutes", "f8", (3,)),
        ("reported_minutes", "f8", (3,)),
        # alarms of an axis since it was last still; minutes for which a jump of all axes is reported
        ("alarms", "f8", (3,)),
        ("jump_minutes", "f8"),
        # the anchor: closed minutes and epoch of the alignment, last answer, levels by it, those if nothing were wrong
        # with any carrier, and sigma of the filter then, deg
        ("anchor_minutes", "i8"),
        ("since_us", "i8"),
        ("answered_us", "i8"),
        ("level_deg", "f8", (3,)),
        ("nominal_deg", "f8", (3,)),
        ("answer_sigma_deg", "f8", (3,)),
        # logarithm of the factor on the drift, >= 0
        ("log_drift_scale", "f8"),
        # commands: share that is carried out, minutes for which it is doubted, evidence on it and on a yaw rate
        ("share", "f8"),
        ("doubted_minutes", "f8"),
        # whether torques were commanded, not corrections of angles alone
        ("is_by_torque", "?"),
        ("score", "f8", (2,)),
        ("information", "f8", (2, 2)),
        # until when each figure of integrity inhibits at least
        ("beyond_until_us", "i8", (FIGURES,)),
    ],
    align=True,
)

#: judgement of the records of wheels or a polarimeter; sums forget
SENSOR = np.dtype(
    [
        # newest record of use, at first the begin of the watch, and newest record judged; microseconds UTC
        ("heard_us", "i8"),
        ("newest_us", "i8"),
        # newest record of wheels, along roll, pitch, yaw: a repeated one is left out
        ("newest_n_m_s", "f8", (3,)),
        # records left out in a row
        ("skipped", "i8"),
        # weights, sum of mean squares of innovations and jumps of the last hours
        ("records", "f8"),
        ("squares", "f8"),
        ("jumps", "f8"),
        ("jumped_us", "i8"),
        ("is_refused", "?"),
        # co-polar power of a polarimeter in clear sky, NaN before the first
        ("clear_dbm", "f8"),
    ],
    align=True,
)

#: judgement of the rates of the body; (3,) yaw, roll, pitch
RATES = np.dtype(
    [
        # whether the newest step was made by a measured rate
        ("is_measured", "?"),
        # newest record judged
        ("newest_us", "i8"),
        ("newest_deg_h", "f8", (3,)),
        # newest record that counted, and its rate beside the commanded one
        ("known_us", "i8"),
        ("residual_deg_h", "f8", (3,)),
        # rate that commands have left; it stands here while the state holds the measured one
        ("commanded_deg_h", "f8", (3,)),
        # newest step with a torque from the ground
        ("torque_us", "i8"),
        # records of the last hours, and those left out
        ("records", "f8"),
        ("wild", "f8"),
        # logarithm of the factor on bias or drift, whichever the state does not hold now
        ("other_log_scale", "f8"),
        ("is_refused", "?"),
    ],
    align=True,
)


class FilterState(NamedTuple):
    """State of the filter between two rows, of N carriers and D numbers."""

    mean: FloatArray
    covariance: FloatArray
    #: (N,) of `CARRIER`
    carriers: NDArray[np.void]
    #: (1,) of `WATCH`
    watch: NDArray[np.void]
    #: (STANDING_ROWS, N) newest last, measured minus what the site explains while a carrier is set aside, dB
    aside_db: FloatArray
    #: (2, ANCHOR_MINUTES, N) newest last, the same of closed minutes, dB, NaN = absent, and their white noise, dB^2
    anchor: FloatArray
    #: (D, 2) derivative of the state by the share of commands and by an unannounced yaw rate, deg/h
    sensitivity: FloatArray
    #: (1 + P,) of `SENSOR`, the wheels and each polarimeter, and (1,) of `RATES`
    sensors: NDArray[np.void]
    rates: NDArray[np.void]

    @property
    def epoch_us(self) -> int:
        """Epoch of the newest row, microseconds UTC."""
        return int(self.watch["epoch_us"][0])

    @property
    def gaussian(self) -> Gaussian:
        """Mean and covariance."""
        return Gaussian(self.mean, self.covariance)

    def with_gaussian(self, gaussian: Gaussian) -> "FilterState":
        """Return the state with other numbers as many."""
        return self._replace(mean=gaussian.mean, covariance=gaussian.covariance)

    def with_watch(self, **values: object) -> "FilterState":
        """Return the state with some fields of the watch replaced."""
        watch = self.watch.copy()
        for name, value in values.items():
            watch[name][0] = value
        return self._replace(watch=watch)

    def with_carriers(self, **values: object) -> "FilterState":
        """Return the state with some fields (N,) of the carriers replaced."""
        carriers = self.carriers.copy()
        for name, value in values.items():
            carriers[name] = value
        return self._replace(carriers=carriers)


def start(model: CarrierModel, epoch_us: int, gaussian: Gaussian, polarimeters: int = 0) -> FilterState:
    """Return the state of a filter that was just aligned.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    epoch_us : int, microseconds UTC
        Epoch of the alignment.
    gaussian : Gaussian
        From `initial_gaussian`.
    polarimeters : int
        How many look at the spacecraft.
    """
    count = model.carriers
    return FilterState(
        gaussian.mean,
        gaussian.covariance,
        initial_carriers(np.diagonal(gaussian.covariance)[-count:], epoch_us),
        initial_watch(epoch_us),
        np.full((STANDING_ROWS, count), np.nan),
        np.full((2, ANCHOR_MINUTES, count), np.nan),
        np.zeros((len(gaussian.mean), 2)),
        initial_sensors(polarimeters, epoch_us),
        initial_rates(),
    )


def initial_carriers(reference_variance_db2: FloatArray, epoch_us: int) -> NDArray[np.void]:
    """Return carriers (N,) that have not failed since the alignment."""
    carriers = np.zeros(len(reference_variance_db2), CARRIER)
    carriers["aligned_variance_db2"] = reference_variance_db2
    carriers["white_scale"], carriers["probability"], carriers["hypothesis_since_us"] = 1.0, np.nan, epoch_us
    return carriers


def initial_sensors(polarimeters: int, epoch_us: int) -> NDArray[np.void]:
    """Return the judgement (1 + P,) of wheels and polarimeters before the first record."""
    sensors = np.zeros(1 + polarimeters, SENSOR)
    sensors["newest_us"] = sensors["jumped_us"] = NEVER_US
    sensors["heard_us"], sensors["clear_dbm"] = epoch_us, np.nan
    return sensors


def initial_rates() -> NDArray[np.void]:
    """Return the judgement (1,) of the rates of the body before the first record."""
    rates = np.zeros(1, RATES)
    rates["newest_us"] = rates["known_us"] = rates["torque_us"] = NEVER_US
    return rates


def initial_watch(epoch_us: int) -> NDArray[np.void]:
    """Return the watch (1,) of a spacecraft that does what it is told, under a dry sky."""
    watch = np.zeros(1, WATCH)
    for name in ("epoch_us", "minute_start_us", "shift_start_us", "since_us", "answered_us"):
        watch[name] = epoch_us
    for name in ("level_deg", "nominal_deg", "answer_sigma_deg", "rain_db"):
        watch[name] = np.nan
    for name in ("slow_scale", "nis_ratio", "share"):
        watch[name] = 1.0
    return watch
