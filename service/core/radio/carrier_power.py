"""Carrier powers from one RMS trace.

Trace bin i holds the mean power p_i [mW] behind the resolution filter over the bucket ``f_i +- df/2``. Then

    P_band = sum_i w_i p_i df / ENBW        power in the integration band [mW], w_i = part of the bucket inside it
    n0     = mean of p_i over the noise windows / ENBW                          noise density [mW/Hz]
    C      = P_band - n0 B_int                                                  carrier power [mW]

A noise window whose mean lies more than 1 dB above its median holds a signal; it is left out when a clean one remains.
All sums of a sweep are one matrix product with weights made once for each setting of the analyzer.
"""

from typing import NamedTuple

import numpy as np

from service.core.radio.band_weights import BandWeights, span_hz, swept_dof
from service.core.radio.decibel import FloatArray, db_from_ratio, dbm_from_mw
from service.core.radio.occupied_bandwidth import occupied_bandwidth_hz
from service.core.radio.predicted_sigma import carrier_sigma_db, line_sigma_db
from service.core.radio.presence import BoolArray, presence_threshold_db


class CarrierPower(NamedTuple):
    """Powers and noise densities of N carriers from one trace."""

    #: (N,) dBm, noise subtracted; NaN where nothing is left above the noise
    power_dbm: FloatArray
    #: (N,) dBm, noise included
    power_total_dbm: FloatArray
    #: (N,) dBm/Hz
    n0_dbm_hz: FloatArray
    #: (N,) dB-Hz, C over noise density
    c_n0_db_hz: FloatArray
    #: (N,) dB, C over noise in the symbol rate
    c_n_db: FloatArray
    #: (N,) dB, predicted standard deviation of power_dbm
    sigma_db: FloatArray
    #: (N,) Hz, centre of gravity of the noise-subtracted band
    centroid_hz: FloatArray
    #: (N,) Hz, width that holds 99 % of the noise-subtracted power; NaN for lines
    occupied_bandwidth_hz: FloatArray
    #: (N,) dB, density inside the carrier over noise density, for the presence test
    presence_ratio_db: FloatArray
    #: (N,) dB
    presence_threshold_db: FloatArray
    #: (N,) every noise window of the carrier holds a signal, or one had to be left out
    is_noise_dirty: BoolArray
    #: (N,) a value inside the band or its windows is not a number
    is_nonfinite: BoolArray


def measure_carriers(power_mw: FloatArray, weights: BandWeights) -> CarrierPower:
    """Return the carrier powers of one trace.

    Parameters
    ----------
    power_mw : ndarray, shape (B,), mW
        RMS trace. Values that are not finite spoil only the carriers whose bands hold them.
    weights : BandWeights
        Of the settings under which the trace was taken.

    Returns
    -------
    CarrierPower
        All arrays (N,).

    Notes
    -----
    Bias below 0.03 dB on synthetic traces of raised-cosine carriers with RBW <= 3% of the symbol rate, beside a
    neighbour 6 dB stronger (``tests/unit/service/core/radio/test_carrier_power.py``).
    """
    n = weights.band_sum.size
    is_finite = np.isfinite(power_mw)
    is_nonfinite = np.zeros(n, dtype=np.bool_)
    if not is_finite.all():
        is_nonfinite = _touches(weights, ~is_finite)
        power_mw = np.where(is_finite, power_mw, 0.0)
    sums = weights.rows @ power_mw
    total_mw, moment, inner_mw, window_mean = sums[:n], sums[n : 2 * n], sums[2 * n : 3 * n], sums[3 * n :]
    noise_bin_mw, noise_hz, is_dirty = _noise_floor(power_mw, weights, window_mean)
    spoilt = np.where(is_nonfinite, np.nan, 1.0)
    carrier_mw = (total_mw - noise_bin_mw * weights.band_sum) * spoilt
    carrier_mw = np.where(carrier_mw > 0.0, carrier_mw, np.nan)
    n0_mw_hz = noise_bin_mw / weights.grid.enbw_hz
    noise_dof = swept_dof(weights.grid, noise_hz)
    c_n0 = db_from_ratio(carrier_mw / n0_mw_hz)
    return CarrierPower(
        dbm_from_mw(carrier_mw),
        dbm_from_mw(total_mw * spoilt),
        dbm_from_mw(n0_mw_hz),
        c_n0,
        c_n0 - 10.0 * np.log10(weights.bands.symbol_rate_hz),
        _sigma_db(noise_bin_mw * weights.band_sum / carrier_mw, noise_dof, weights),
        weights.bands.center_hz + (moment - noise_bin_mw * weights.moment_sum_hz) / carrier_mw,
        occupied_bandwidth_hz(power_mw, noise_bin_mw, weights) * spoilt,
        db_from_ratio(inner_mw * spoilt / noise_bin_mw),
        presence_threshold_db(weights.inner_dof, noise_dof),
        is_dirty,
        is_nonfinite,
    )


def hide_absent(power: CarrierPower, is_visible: BoolArray) -> CarrierPower:
    """Return the powers with the level, its sigma, centre and width NaN where no carrier is visible.

    Parameters
    ----------
    power : CarrierPower
        Of one trace.
    is_visible : ndarray, shape (N,)
        From `service.core.radio.presence.step_presence`.

    Returns
    -------
    CarrierPower
        ``power_total_dbm`` and ``n0_dbm_hz`` stay: they bound what an absent carrier could have been.
    """

    def hidden(values: FloatArray) -> FloatArray:
        return np.where(is_visible, values, np.nan)

    return power._replace(
        power_dbm=hidden(power.power_dbm),
        c_n0_db_hz=hidden(power.c_n0_db_hz),
        c_n_db=hidden(power.c_n_db),
        sigma_db=hidden(power.sigma_db),
        centroid_hz=hidden(power.centroid_hz),
        occupied_bandwidth_hz=hidden(power.occupied_bandwidth_hz),
    )


def _noise_floor(
    power_mw: FloatArray, weights: BandWeights, window_mean: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return noise per bin, width of the windows used, and whether a window of the carrier was dirty."""
    medians = np.array([np.median(power_mw[bins]) for bins in weights.window_bins]) / weights.median_ratio
    is_clean: BoolArray = np.less_equal(window_mean, weights.dirty_ratio * medians)
    width_hz = weights.window_hz * is_clean
    has_clean: BoolArray = np.any(width_hz, axis=1)
    # Where every window is dirty the median still bounds the floor better than the mean.
    values = np.where(is_clean, window_mean, medians)
    width_hz = np.where(has_clean[:, np.newaxis], width_hz, weights.window_hz)
    used_hz: FloatArray = width_hz.sum(axis=1)
    noise_bin_mw: FloatArray = width_hz @ values / used_hz
    is_dirty: BoolArray = np.any(weights.window_hz * ~is_clean, axis=1)
    return np.where(noise_bin_mw > 0.0, noise_bin_mw, np.nan), used_hz, is_dirty


def _sigma_db(noise_to_carrier: FloatArray, noise_dof: FloatArray, weights: BandWeights) -> FloatArray:
    """Return the predicted sigma of modulated carriers and lines."""
    grid, bands = weights.grid, weights.bands
    time_bandwidth = grid.enbw_hz * grid.sweep_time_s * grid.enbw_hz / span_hz(grid)
    of_line = line_sigma_db(
        noise_to_carrier, time_bandwidth, bands.integration_bw_hz / grid.enbw_hz, weights.band_dof, noise_dof
    )
    of_carrier = carrier_sigma_db(noise_to_carrier, weights.carrier_dof, weights.band_dof, noise_dof)
    return np.where(bands.is_line, of_line, of_carrier)


def _touches(weights: BandWeights, is_bad: BoolArray) -> BoolArray:
    """Return the carriers whose band or noise windows hold a bad value."""
    n = weights.band_sum.size
    touched = (weights.rows != 0.0) @ is_bad.astype(np.int64) > 0
    by_window: BoolArray = (weights.window_hz > 0.0) @ touched[3 * n :].astype(np.int64) > 0
    return np.asarray(touched[:n] | by_window, dtype=np.bool_)
