"""Numeric settings: limits, how each is stored and shown, what UP and DOWN do.

Law of this file: a numeric setting has one row in ``QUANTITIES``; nothing else clamps. Offsets are added where it is
shown. Every limit and every step is a figure of the model.
"""

from collections.abc import Callable
from dataclasses import dataclass

from analyzer_sim.instrument.instrument_settings import MAX_SWEEPS, Limits, Settings


def _store_window(settings: Settings, center_hz: float, span_hz: float) -> None:
    """Place the sweep; a span that leaves the band is narrowed about its centre."""
    half = min(0.5 * span_hz, center_hz, settings.model.max_frequency_hz - center_hz)
    settings.start_hz, settings.stop_hz = center_hz - half, center_hz + half


def _store_start(settings: Settings, start_hz: float) -> None:
    settings.start_hz = start_hz
    settings.stop_hz = max(settings.stop_hz, start_hz + settings.model.min_span_hz)


def _store_stop(settings: Settings, stop_hz: float) -> None:
    settings.stop_hz = stop_hz
    settings.start_hz = min(settings.start_hz, stop_hz - settings.model.min_span_hz)


def _store_span(settings: Settings, span_hz: float) -> None:
    model = settings.model
    legal_hz = 0.0 if span_hz < 0.5 * model.min_span_hz else max(span_hz, model.min_span_hz)
    if not legal_hz and settings.is_rbw_auto:
        settings.rbw_chosen_hz = settings.rbw_shown_hz
    if legal_hz != settings.span_hz:
        settings.previous_span_hz = settings.span_hz
    center_hz = min(max(settings.center_hz, 0.5 * legal_hz), model.max_frequency_hz - 0.5 * legal_hz)
    _store_window(settings, center_hz, legal_hz)


def _store_rbw(settings: Settings, rbw_hz: float) -> None:
    settings.rbw_chosen_hz, settings.is_rbw_auto = settings.model.rbw.legal(rbw_hz), False


def _store_vbw(settings: Settings, vbw_hz: float) -> None:
    settings.vbw_chosen_hz, settings.is_vbw_auto = settings.model.vbw.legal(vbw_hz), False


def _store_time(settings: Settings, time_s: float) -> None:
    settings.time_chosen_s, settings.is_time_auto = time_s, False


def _store_attenuation(settings: Settings, attenuation_db: float) -> None:
    step_db = settings.model.attenuation_step_db
    settings.attenuation_chosen_db, settings.is_attenuation_auto = step_db * round(attenuation_db / step_db), False


@dataclass(frozen=True, slots=True)
class Quantity:
    """One numeric setting."""

    limits: Callable[[Settings], Limits]
    load: Callable[[Settings], float]
    store: Callable[[Settings, float], None]
    #: change that UP (+1) and DOWN (-1) make
    step: Callable[[Settings, int], float]
    #: what is added where the setting is shown
    shift: Callable[[Settings], float] = lambda _settings: 0.0
    #: the instrument accepts any value and keeps its own
    is_ignored: Callable[[Settings], bool] = lambda _settings: False


def _fixed(low: float, high: float, default: float) -> Callable[[Settings], Limits]:
    limits = Limits(low, high, default)
    return lambda _settings: limits


def _put(attribute: str) -> Callable[[Settings, float], None]:
    return lambda settings, value: setattr(settings, attribute, value)


def _put_whole(attribute: str) -> Callable[[Settings, float], None]:
    return lambda settings, value: setattr(settings, attribute, round(value))


def _by(step: float) -> Callable[[Settings, int], float]:
    return lambda _settings, direction: direction * step


def _by_half(attribute: str) -> Callable[[Settings, int], float]:
    return lambda settings, direction: direction * 0.5 * float(getattr(settings, attribute))


def _axis_step(settings: Settings, direction: int) -> float:
    return direction * max(settings.span_hz, settings.model.min_span_hz) / 10.0


def _center_limits(settings: Settings) -> Limits:
    half_hz, high_hz = 0.5 * settings.model.min_span_hz, settings.model.max_frequency_hz
    return Limits(half_hz, high_hz - half_hz, 0.5 * high_hz)


def _span_limits(settings: Settings) -> Limits:
    return Limits(0.0, settings.model.max_frequency_hz, settings.model.max_frequency_hz)


def _step_limits(settings: Settings) -> Limits:
    return Limits(1.0, settings.model.max_frequency_hz, settings.span_hz / 10.0)


def _start_limits(settings: Settings) -> Limits:
    return Limits(0.0, settings.model.max_frequency_hz - settings.model.min_span_hz, 0.0)


def _stop_limits(settings: Settings) -> Limits:
    return Limits(settings.model.min_span_hz, settings.model.max_frequency_hz, settings.model.max_frequency_hz)


QUANTITIES: dict[str, Quantity] = {
    "center_hz": Quantity(
        _center_limits,
        lambda s: s.center_hz,
        lambda s, value: _store_window(s, value, s.span_hz),
        lambda s, direction: direction * s.step_hz,
        shift=lambda s: s.offset_hz,
    ),
    "span_hz": Quantity(_span_limits, lambda s: s.span_hz, _store_span, _by_half("span_hz")),
    "step_hz": Quantity(_step_limits, lambda s: s.step_hz, _put("step_chosen_hz"), _by_half("step_hz")),
    "start_hz": Quantity(_start_limits, lambda s: s.start_hz, _store_start, _axis_step, shift=lambda s: s.offset_hz),
    "stop_hz": Quantity(_stop_limits, lambda s: s.stop_hz, _store_stop, _axis_step, shift=lambda s: s.offset_hz),
    "offset_hz": Quantity(_fixed(-1e12, 1e12, 0.0), lambda s: s.offset_hz, _put("offset_hz"), _by(1e6)),
    "rbw_hz": Quantity(
        lambda s: s.model.rbw.limits,
        lambda s: s.rbw_shown_hz,
        _store_rbw,
        lambda s, direction: s.model.rbw.neighbour(s.rbw_shown_hz, direction) - s.rbw_shown_hz,
    ),
    "vbw_hz": Quantity(
        lambda s: s.model.vbw.limits,
        lambda s: s.vbw_hz,
        _store_vbw,
        lambda s, direction: s.model.vbw.neighbour(s.vbw_hz, direction) - s.vbw_hz,
    ),
    "rbw_per_span": Quantity(
        lambda s: Limits(1e-5, 1.0, 1.0 / s.model.span_per_rbw),
        lambda s: 1.0 / s.span_per_rbw,
        lambda s, ratio: setattr(s, "span_per_rbw", 1.0 / ratio),
        lambda s, direction: direction * 0.5 / s.span_per_rbw,
    ),
    "span_per_rbw": Quantity(
        lambda s: Limits(1.0, 1e5, s.model.span_per_rbw),
        lambda s: s.span_per_rbw,
        _put("span_per_rbw"),
        _by_half("span_per_rbw"),
    ),
    "vbw_per_rbw": Quantity(
        lambda s: Limits(1e-5, 1e6, s.model.vbw_per_rbw),
        lambda s: s.vbw_per_rbw,
        _put("vbw_per_rbw"),
        _by_half("vbw_per_rbw"),
    ),
    "points": Quantity(
        lambda s: s.model.points,
        lambda s: s.points,
        _put_whole("points"),
        _by_half("points"),
        is_ignored=lambda s: s.model.are_points_fixed,
    ),
    "time_s": Quantity(lambda s: s.model.sweep_time_s, lambda s: s.time_s, _store_time, _by_half("time_s")),
    "count": Quantity(_fixed(0, MAX_SWEEPS, 0), lambda s: s.count, _put_whole("count"), _by(1.0)),
    "average_count": Quantity(
        lambda s: s.model.average_count, lambda s: s.average_count, _put_whole("average_count"), _by(1.0)
    ),
    "reference_dbm": Quantity(
        lambda s: s.model.reference_dbm,
        lambda s: s.reference_dbm,
        _put("reference_dbm"),
        _by(10.0),
        shift=lambda s: s.level_offset_db,
    ),
    "level_offset_db": Quantity(
        lambda s: s.model.level_offset_db, lambda s: s.level_offset_db, _put("level_offset_db"), _by(1.0)
    ),
    "attenuation_db": Quantity(
        lambda s: s.model.attenuation_db,
        lambda s: s.attenuation_db,
        _store_attenuation,
        lambda s, direction: direction * s.model.attenuation_coupled_step_db,
    ),
}


def shown_limits(settings: Settings, name: str) -> Limits:
    """Return the limits of a setting as they are shown, the offset included."""
    quantity = QUANTITIES[name]
    return Limits(*(value + quantity.shift(settings) for value in quantity.limits(settings)))


def load(settings: Settings, name: str) -> float:
    """Return the value of a numeric setting as it is shown."""
    quantity = QUANTITIES[name]
    return quantity.load(settings) + quantity.shift(settings)


def store(settings: Settings, name: str, value: float) -> bool:
    """Store a value as shown; return whether it had to be clamped to its limits."""
    quantity = QUANTITIES[name]
    if quantity.is_ignored(settings):
        return False
    limits = quantity.limits(settings)
    inner = value - quantity.shift(settings)
    clamped = min(max(inner, limits.low), limits.high)
    quantity.store(settings, clamped)
    return clamped != inner
