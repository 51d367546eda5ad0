"""Beams: boresight of each antenna against the body, and uplink beams at the stations."""

from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator

from service.api.schemas.base import Answer, EpochAnswer, Figure, WindowAnswer
from service.core.estimation.beams.boresight_wave import BoresightFit, Wave
from service.pipeline.carrier_model.beam_report import AntennaReport, Group, StationReport, WaveCause
from service.records.levels.attitude import FloatArray
from service.runtime.jobs.beam_analysis import BeamAnalysis


def _without_nan(values: Any) -> Any:
    """Return the list of an array, NaN as None."""
    if not isinstance(values, np.ndarray):
        return values
    return [None if np.isnan(value) else value for value in values.tolist()]


_Column = Annotated[list[float | None], BeforeValidator(_without_nan)]


class WaveAnswer(Answer):
    """Periodic part of a boresight; nulls: the series is too short to tell it."""

    amplitude_deg: Figure
    """Size of the wave, deg."""
    sigma_deg: Figure
    """Standard deviation of its cosine and of its sine, deg; that of the calibration's own daily change included."""
    peak_h: Figure
    """When it is greatest, h: after midnight UTC; of the yearly wave, after the start of 1970 and whole years."""

    @classmethod
    def of_wave(cls, wave: Wave) -> Self:
        """Return the answer for a wave."""
        return super().of(wave, peak_h=wave.peak_s / 3600.0)


class AxisAnswer(Answer):
    """Change of a boresight along one axis of the antenna frame."""

    mean_deg: Figure
    """At the middle of the series, deg, counted from the calibration; East and North positive."""
    mean_sigma_deg: Figure
    """Sigma of the mean by the scatter of the hours, deg; `constant_sigma_deg` comes on top."""
    constant_sigma_deg: Figure
    """Sigma of what all hours share, deg: levels of single carriers that changed since the calibration."""
    drift_deg_per_day: Figure
    """Steady change, deg a day."""
    drift_sigma_deg_per_day: Figure
    """Sigma of the steady change, deg a day."""
    daily: WaveAnswer
    """Period of the solar day; told by 36 hours or more."""
    yearly: WaveAnswer
    """Period of 365.25 days; told by 300 days or more."""
    residual_rms_deg: Figure
    """Scatter of the hours about this change, deg."""

    @classmethod
    def of_fit(cls, fit: BoresightFit, constant_sigma_deg: float) -> Self:
        """Return the answer for the fit of an axis."""
        waves = {"daily": WaveAnswer.of_wave(fit.daily), "yearly": WaveAnswer.of_wave(fit.yearly)}
        return super().of(fit, constant_sigma_deg=constant_sigma_deg, **waves)


class AntennaAnswer(Answer):
    """Boresight of one antenna, column by column over the hours of the answer."""

    antenna: str
    """Band or transponder that the carriers share."""
    carriers: list[str]
    """Carriers that tell it."""
    cause: WaveCause
    """Cause of a daily change: `none` found; `antenna`: others do not show it; `antenna_or_sensor`: there is no other;
    `body_or_sensor`: the others show the same."""
    east: AxisAnswer
    north: AxisAnswer
    east_deg: _Column
    """Boresight towards East of where the calibration had it, deg; null: fewer than five carriers tell it."""
    north_deg: _Column
    """The same towards North, deg."""
    east_sigma_deg: _Column
    """Sigma of the hour by the scatter of the carriers, deg."""
    north_sigma_deg: _Column
    common_db: _Column
    """Level that the carriers share, dB above the expected one."""
    carriers_used: list[int]
    """Carriers that count in the hour."""
    residual_rms_db: Figure
    """Of the carriers used, over all hours, dB."""

    @classmethod
    def of_report(cls, report: AntennaReport) -> Self:
        """Return the answer for an antenna."""
        series = report.series
        constant: FloatArray = series.constant_sigma_deg
        return super().of(
            series,
            antenna=report.antenna,
            carriers=list(report.carrier_ids),
            cause=report.cause,
            east=AxisAnswer.of_fit(report.east, float(constant[0])),
            north=AxisAnswer.of_fit(report.north, float(constant[1])),
            east_deg=series.boresight_deg[:, 0],
            north_deg=series.boresight_deg[:, 1],
            east_sigma_deg=series.sigma_deg[:, 0],
            north_sigma_deg=series.sigma_deg[:, 1],
            carriers_used=series.carriers_used.tolist(),
        )


class GradientAnswer(Answer):
    """Gradient of an uplink beam, dB/deg."""

    east: Figure
    north: Figure


class CurvatureAnswer(Answer):
    """Second derivatives of an uplink beam, dB/deg^2."""

    east_east: Figure
    east_north: Figure
    north_north: Figure


class StationBeamAnswer(Answer):
    """Uplink beam at the station of one carrier, as the calibration measured it."""

    carrier: str
    transponder: str
    azimuth_deg: float
    """Place of the station in the antenna frame, deg towards East of nadir."""
    elevation_deg: float
    """The same towards North, deg."""
    gradient_db_per_deg: GradientAnswer
    """Rise of the gain towards East and North at the station, dB/deg."""
    gradient_sigma_db_per_deg: GradientAnswer
    """Sigmas of the gradient, dB/deg."""
    curvature_db_per_deg2: CurvatureAnswer
    """Curvature of the gain at the station, dB/deg^2."""
    curvature_sigma_db_per_deg2: CurvatureAnswer
    """Sigmas of the curvature, dB/deg^2."""
    change_sigmas: Figure
    """By how many sigmas the gradient differs from that of the campaign before; above 3 by chance for one station in
    ninety; null: no campaign before had this station there."""

    @classmethod
    def of_report(cls, report: StationReport) -> Self:
        """Return the answer for a station."""
        gradients = {
            f"gradient{part}_db_per_deg": dict(zip(("east", "north"), values, strict=True))
            for part, values in (("", report.gradient), ("_sigma", report.gradient_sigma))
        }
        curvatures = {
            f"curvature{part}_db_per_deg2": dict(zip(CurvatureAnswer.model_fields, values, strict=True))
            for part, values in (("", report.curvature), ("_sigma", report.curvature_sigma))
        }
        return super().of(report, **gradients, **curvatures)


class BeamsAnswer(Answer):
    """Boresights and beams of a spacecraft by its carriers and a working sensor."""

    range: WindowAnswer
    group: Group
    """Carriers that are taken for those of one antenna."""
    calibration_id: int
    """The active calibration by geometry, from which boresights are counted."""
    compared_calibration_id: int | None
    """Campaign that gradients are compared with; null: there is none before."""
    sensors: list[str]
    """Sensors whose angles are subtracted."""
    day_step: int
    """1: every day was read; 7: every seventh."""
    epochs: list[EpochAnswer]
    """Begin of the hours that have both powers and angles."""
    turned: list[bool]
    """Hours in which roll or pitch ranged by more than 0.1 deg; they tell no boresight."""
    antennas: list[AntennaAnswer]
    stations: list[StationBeamAnswer]
    notes: list[str]
    """Limits of the figures' validity."""

    @classmethod
    def of_analysis(cls, analysis: BeamAnalysis, group: Group) -> Self:
        """Return the answer for an analysis."""
        report = analysis.report
        return super().of(
            analysis,
            range=analysis.window,
            group=group,
            sensors=list(dict.fromkeys(analysis.sensors)),
            epochs=report.hours.start_us.tolist(),
            turned=report.is_turned.tolist(),
            antennas=[AntennaAnswer.of_report(one) for one in report.antennas],
            stations=[StationBeamAnswer.of_report(one) for one in report.stations],
        )
