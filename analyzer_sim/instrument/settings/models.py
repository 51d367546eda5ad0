"""Figures of the four makes the simulator plays. [M] is in a maker's manual, the others are engineering defaults.

Deviations from the real instruments, on purpose: all have one resolution filter shape (Gaussian); the counts of sweeps
end at ``MAX_SWEEPS``.
"""

from analyzer_sim.instrument.settings.analyzer_model import MAX_SWEEPS, AnalyzerModel, FilterSteps, Limits, decade_steps

_RS_STEPS = FilterSteps(decade_steps((1, 2, 3, 5), 1.0, 10e6))
_E24 = (
    *(1.0, 1.1, 1.2, 1.3, 1.5, 1.6, 1.8, 2.0, 2.2, 2.4, 2.7, 3.0),
    *(3.3, 3.6, 3.9, 4.3, 4.7, 5.1, 5.6, 6.2, 6.8, 7.5, 8.2, 9.1),
)
_WIDE_STEPS = (4e6, 5e6, 6e6, 8e6)
_ONE_THREE = (1.0, 3.0)

#: Rohde & Schwarz FSW-26
FSW_26 = AnalyzerModel(
    max_frequency_hz=26.5e9,
    rbw=_RS_STEPS,
    vbw=_RS_STEPS,
    points=Limits(101, 100001, 1001),
    sweep_time_s=Limits(1e-3, 16000.0, 1.0),
    reference_dbm=Limits(-130.0, 30.0, 0.0),
    level_offset_db=Limits(-200.0, 200.0, 0.0),
    attenuation_db=Limits(0.0, 79.0, 10.0),
    attenuation_step_db=1.0,
    attenuation_coupled_step_db=5.0,
    average_count=Limits(0, MAX_SWEEPS, 0),
    channel_width_hz=Limits(100.0, 1e9, 14e3),
    is_continuous_after_reset=True,
    is_continuous_after_preset=True,
)

#: Keysight N9020B with option 526; E24 filter steps up to 3 MHz, then 4 5 6 8 MHz [M]
N9020B = AnalyzerModel(
    max_frequency_hz=26.5e9,
    rbw=FilterSteps((*decade_steps(_E24, 1.0, 3e6), *_WIDE_STEPS)),
    vbw=FilterSteps((*decade_steps(_E24, 1.0, 3e6), *_WIDE_STEPS, 50e6)),
    points=Limits(1, 100001, 1001),
    sweep_time_s=Limits(1e-3, 4000.0, 1.0),
    reference_dbm=Limits(-170.0, 30.0, 0.0),
    level_offset_db=Limits(-327.6, 327.6, 0.0),
    attenuation_db=Limits(0.0, 70.0, 10.0),
    attenuation_step_db=2.0,
    attenuation_coupled_step_db=2.0,
    average_count=Limits(1, MAX_SWEEPS, 100),
    channel_width_hz=Limits(1e3, 1e9, 2e6),
    span_per_rbw=106.0,
    is_continuous_after_reset=False,
    is_continuous_after_preset=True,
    is_big_endian=True,
    uncalibrated_bit=9,
    no_error='+0,"No error"',
)

#: Siglent SSA3032X; 751 points whatever is asked; filters nearest on a linear scale, rounding up [M]
SSA3032X = AnalyzerModel(
    max_frequency_hz=3.2e9,
    min_span_hz=100.0,
    rbw=FilterSteps(decade_steps(_ONE_THREE, 1.0, 1e6), is_linear=True),
    vbw=FilterSteps(decade_steps(_ONE_THREE, 1.0, 3e6), is_linear=True),
    points=Limits(751, 751, 751),
    sweep_time_s=Limits(917e-6, 1000.0, 1.0),
    reference_dbm=Limits(-100.0, 30.0, 0.0),
    level_offset_db=Limits(-300.0, 300.0, 0.0),
    attenuation_db=Limits(0.0, 51.0, 10.0),
    attenuation_step_db=1.0,
    attenuation_coupled_step_db=1.0,
    average_count=Limits(1, 999, 100),
    channel_width_hz=Limits(100.0, 3.2e9, 2e6),
    is_continuous_after_reset=True,
    is_continuous_after_preset=True,
    detector="POS",
    are_points_fixed=True,
    error_queue_depth=20,
)

#: Anritsu MS2090A with option 0726; couplings span/RBW 300, VBW/RBW 0.33, averages 2 to 65535 as its kin have [M]
MS2090A = AnalyzerModel(
    max_frequency_hz=26.5e9,
    rbw=FilterSteps(decade_steps(_ONE_THREE, 1.0, 10e6)),
    vbw=FilterSteps(decade_steps(_ONE_THREE, 1.0, 10e6)),
    points=Limits(10, 20001, 501),
    sweep_time_s=Limits(10e-6, 600.0, 1.0),
    reference_dbm=Limits(-150.0, 30.0, 0.0),
    level_offset_db=Limits(-100.0, 100.0, 0.0),
    attenuation_db=Limits(0.0, 65.0, 10.0),
    attenuation_step_db=5.0,
    attenuation_coupled_step_db=5.0,
    average_count=Limits(2, MAX_SWEEPS, 10),
    channel_width_hz=Limits(0.0, 26.5e9, 0.0),
    span_per_rbw=300.0,
    vbw_per_rbw=0.33,
    is_continuous_after_reset=True,
    is_continuous_after_preset=True,
    detector="POS",
    error_queue_depth=20,
)
