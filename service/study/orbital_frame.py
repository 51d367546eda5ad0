"""Orbital-frame control of Meteor-M No. 2 (Belenkii, Vasilev, Semenov): figures of the paper beside those of the model.

One row a published figure, with the flight that gives it.
"""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from service.core.dynamics.orbital_frame_analysis import (
    FlightRecord,
    Start,
    fly_spacecraft,
    harmonic_amplitude,
    largest_after,
    mean_over_orbits,
    time_within,
    trimmed_correction_rad_s,
)
from service.core.dynamics.orbital_frame_kernel import Fly
from service.core.dynamics.orbital_frame_model import (
    MAX_GAINS,
    MIN_GAINS,
    NOMINAL_INERTIA,
    ORBITAL_RATE_RAD_S,
    AxisWheels,
    Law,
    OrbitalFrameGains,
    OrbitalFrameSpacecraft,
    RateSensor,
    Tones,
    VerticalSensor,
    rigid_spacecraft,
)
from service.study.published import Row, row, statement_row

ORBIT_S = 2.0 * math.pi / ORBITAL_RATE_RAD_S
#: s, length of the flights of the paper's stabilisation
STABILISATION_S = 15_000.0
#: s, after which the start is forgotten
SETTLED_S = 1500.0
#: every disturbance, smallest yaw gains
_UNCORRECTED = OrbitalFrameSpacecraft(law=Law(gains=MIN_GAINS))


def reproduce(kernel: Fly, report: Callable[[str], None] = lambda _what: None) -> tuple[Row, ...]:
    """Return every row of the table.

    Parameters
    ----------
    kernel : callable
        ``fly`` or its compiled form.
    report : callable
        Receives the name of the next part.
    """
    rows: list[Row] = []
    for what, part in (
        ("transients", _transients),
        ("transients, smallest gains", _slow_transients),
        ("products of inertia", _products),
        ("quantum of torque", _quantum),
        ("null of the roll rate", _null),
        ("everything at once", _everything),
        ("noise of the vertical sensor", _noise),
        ("friction of the wheels", _friction),
        ("flexible tones", _tones),
    ):
        report(what)
        rows += part(kernel)
    return tuple(rows)


def transient_flights(kernel: Fly, gains: OrbitalFrameGains = MAX_GAINS) -> tuple[FlightRecord, FlightRecord]:
    """Return the flights of figures 2 and 3: yaw of 10 and roll of 2 degrees at the start."""
    spacecraft = rigid_spacecraft(gains)
    return (
        fly_spacecraft(spacecraft, Start(yaw_deg=10.0), 2000.0, kernel=kernel),
        fly_spacecraft(spacecraft, Start(roll_deg=2.0), 2000.0, kernel=kernel),
    )


def _transients(kernel: Fly) -> list[Row]:
    return _transient_rows(*transient_flights(kernel), "rigid, ideal sensors, continuous, largest gains")


def _slow_transients(kernel: Fly) -> list[Row]:
    return _transient_rows(*transient_flights(kernel, MIN_GAINS), "the same, smallest yaw gains", is_known_miss=True)


def _transient_rows(
    yaw: FlightRecord, roll: FlightRecord, parameters: str, *, is_known_miss: bool = False
) -> list[Row]:
    """Return what the print says of both transients; it does not say with which gains they were flown."""
    first_s = float(yaw.time_s[np.flatnonzero(np.abs(yaw.yaw_deg) <= 0.1)[0]])
    settled_s = time_within(roll.time_s, roll.roll_deg, 0.02)
    roll_deg, yaw_deg = float(np.abs(yaw.roll_deg).max()), float(np.abs(roll.yaw_deg).max())
    return [
        row("yaw of 10 deg: time to 0.1 deg", parameters, 1000.0, first_s, "s", is_bound=True),
        row("yaw of 10 deg: largest roll", parameters, 0.5, roll_deg, "deg", is_bound=True),
        row("roll of 2 deg: time to 1 % of it", parameters, 800.0, settled_s, "s", is_bound=True),
        row(
            *("roll of 2 deg: largest yaw, about", parameters, 5.0, yaw_deg, "deg"),
            within=0.5,
            is_known_miss=is_known_miss,
        ),
    ]


def _products(kernel: Fly) -> list[Row]:
    flight = fly_spacecraft(rigid_spacecraft(MAX_GAINS, NOMINAL_INERTIA), Start(), STABILISATION_S, kernel=kernel)
    late = flight.time_s > STABILISATION_S - ORBIT_S
    yaw, roll = (
        harmonic_amplitude(flight.time_s[late], each[late], ORBIT_S) for each in (flight.yaw_deg, flight.roll_deg)
    )
    with_products = "products of inertia, largest gains"
    return [
        row("harmonic of yaw", with_products, 0.017, yaw, "deg", within=0.0005, is_fitted=True),
        row("harmonic of roll", with_products, 0.0018, roll, "deg", within=0.00005),
        row("yaw over roll", with_products, 9.44, yaw / roll, "", within=0.55),
    ]


def _quantum(kernel: Fly) -> list[Row]:
    rows = []
    spacecraft = rigid_spacecraft(MAX_GAINS, NOMINAL_INERTIA, is_sampled=True)
    noisy = spacecraft._replace(rate_sensor=RateSensor(null_rad_s=(0.0, 0.0, 0.0)))
    for flown, parameters, has_noise in (
        (spacecraft, "quantum of torque, no noise, largest gains", False),
        (noisy, "quantum of torque, rate noise 2e-7 rad/s, largest gains", True),
    ):
        roll, _, yaw = largest_after(fly_spacecraft(flown, Start(), STABILISATION_S, kernel=kernel), SETTLED_S)
        yaw_figure, roll_figure = ("peak of yaw", parameters, 0.034, yaw), ("peak of roll", parameters, 0.0035, roll)
        rows.append(row(*yaw_figure, "deg", within=0.001, is_fitted=has_noise, is_known_miss=not has_noise))
        rows.append(row(*roll_figure, "deg", within=0.0003, is_known_miss=not has_noise))
    return rows


def _null(kernel: Fly) -> list[Row]:
    rows = []
    for sign in (-1.0, 1.0):
        sensor = RateSensor(null_rad_s=(sign * 1.8e-7, 0.0, 0.0))
        spacecraft = rigid_spacecraft(MAX_GAINS, NOMINAL_INERTIA, is_sampled=True)._replace(rate_sensor=sensor)
        mean_deg = mean_over_orbits(
            fly_spacecraft(spacecraft, Start(), STABILISATION_S, kernel=kernel), ORBITAL_RATE_RAD_S
        )
        rows.append(
            row(
                f"constant yaw, null {sign * 1.8e-7:+.1e} rad/s",
                "quantum, rate noise, largest gains",
                -sign * 0.01,
                mean_deg,
                "deg",
                within=0.0005,
                is_fitted=True,
            )
        )
    return rows


def full_spacecraft(kernel: Fly) -> OrbitalFrameSpacecraft:
    """Return the spacecraft of figure 4: every disturbance, smallest yaw gains, the yaw rate's zero corrected."""
    spacecraft = _UNCORRECTED
    correction = trimmed_correction_rad_s(spacecraft, STABILISATION_S, kernel)
    return spacecraft._replace(computer=spacecraft.computer._replace(yaw_rate_correction_rad_s=correction))


def _everything(kernel: Fly) -> list[Row]:
    smallest = full_spacecraft(kernel)
    peaks = [
        largest_after(fly_spacecraft(smallest, Start(), STABILISATION_S, seed, kernel), SETTLED_S)
        for seed in range(1, 6)
    ]
    roll, pitch, yaw = np.max(peaks, axis=0).tolist()
    everything = "every disturbance, smallest yaw gains, corrected, worst of 5 seeds"
    largest = trimmed_correction_rad_s(OrbitalFrameSpacecraft(), STABILISATION_S, kernel)
    steeper = OrbitalFrameSpacecraft(
        computer=OrbitalFrameSpacecraft().computer._replace(yaw_rate_correction_rad_s=largest)
    )
    _, _, better = largest_after(fly_spacecraft(steeper, Start(), STABILISATION_S, kernel=kernel), SETTLED_S)
    before_deg, after_deg = (
        mean_over_orbits(fly_spacecraft(each, Start(), STABILISATION_S, kernel=kernel), ORBITAL_RATE_RAD_S)
        for each in (_UNCORRECTED, smallest)
    )
    mean = "mean of yaw over two orbits"
    return [
        statement_row(
            *(mean, "every disturbance, smallest yaw gains, not corrected", "constant part", before_deg, "deg"),
            is_met=abs(before_deg) > yaw,
        ),
        statement_row(
            *(mean, "the same, yaw rate corrected by a constant", "compensated", after_deg, "deg"),
            is_met=abs(after_deg) < 0.01 * abs(before_deg),
            is_fitted=True,
        ),
        row("peak of yaw", everything, 0.14, yaw, "deg", is_bound=True, is_fitted=True),
        row("peak of roll", everything, 0.02, roll, "deg", is_bound=True, is_fitted=True),
        row("peak of pitch", everything, 0.01, pitch, "deg", is_bound=True, is_fitted=True),
        row("peak of yaw: smaller", "the same, largest yaw gains", round(yaw, 4), better, "deg", is_bound=True),
    ]


def _noise(kernel: Fly) -> list[Row]:
    """Return what noise of the vertical sensor alone makes of yaw: long waves, although its own time is a second."""
    spacecraft = rigid_spacecraft(MAX_GAINS, is_sampled=True)._replace(vertical_sensor=VerticalSensor())
    flight = fly_spacecraft(spacecraft, Start(), STABILISATION_S, kernel=kernel)
    yaw_deg = flight.yaw_deg[flight.time_s > SETTLED_S]
    power = np.cumsum(np.abs(np.fft.rfft(yaw_deg - yaw_deg.mean())) ** 2)
    half = int(np.searchsorted(power, 0.5 * power[-1]))
    period_s = len(yaw_deg) * spacecraft.computer.period_s / half
    alone = "noise of the vertical sensor alone, largest gains"
    return [
        statement_row("rms of yaw", alone, "shows in yaw", float(yaw_deg.std()), "deg", is_met=yaw_deg.std() > 1e-3),
        statement_row(
            *("period above which half of its power lies", alone, "as harmonics", period_s, "s"),
            is_met=period_s > 100.0 * spacecraft.vertical_sensor.noise_time_s,
        ),
    ]


def _friction(kernel: Fly) -> list[Row]:
    """Return what each part of the wheels' model alone does to the mean of yaw."""
    rigid = rigid_spacecraft(MIN_GAINS, NOMINAL_INERTIA, is_sampled=True)
    none = AxisWheels(dry_friction_n_m=0.0, viscous_friction_n_m_s=0.0, cogging_n_m=0.0, no_load_rad_s=1e9)
    parts = {
        name: getattr(AxisWheels(), name) for name in none._fields if getattr(none, name) != getattr(AxisWheels(), name)
    }
    means = {}
    for name, value in parts.items():
        spacecraft = rigid._replace(wheels=none._replace(**{name: value}))
        flight = fly_spacecraft(spacecraft, Start(), STABILISATION_S, kernel=kernel)
        means[name] = abs(mean_over_orbits(flight, ORBITAL_RATE_RAD_S))
    dry_deg = means.pop("dry_friction_n_m")
    share = max(means.values()) / dry_deg
    what = "next part of the wheels' model over dry friction, mean of yaw"
    return [row(what, "each alone, quantum of torque, smallest yaw gains", 1.0, share, "", is_bound=True)]


def _tones(kernel: Fly) -> list[Row]:
    """Return what flexible tones do: nothing with these gains, a resonance with higher ones and an older rate."""
    flown = (full_spacecraft(kernel), full_spacecraft(kernel)._replace(tones=Tones(is_real=False)))
    peaks = [
        largest_after(fly_spacecraft(spacecraft, Start(), STABILISATION_S, kernel=kernel), SETTLED_S)[2]
        for spacecraft in flown
    ]
    no_change = "every disturbance, smallest yaw gains, corrected"
    rows = [row("peak of yaw with tones over that without", no_change, 1.0, peaks[0] / peaks[1], "", within=0.02)]
    for factor, which, said in ((16.0, "16 times the largest", "resonance"), (1.0, "the largest", "avoided")):
        gains = MAX_GAINS._replace(
            yaw_stiffness=factor * MAX_GAINS.yaw_stiffness, yaw_damping=factor * MAX_GAINS.yaw_damping
        )
        spacecraft = OrbitalFrameSpacecraft(law=Law(gains=gains), rate_sensor=RateSensor(delay_periods=4))
        torque = fly_spacecraft(spacecraft, Start(), 2.0 * SETTLED_S, kernel=kernel).torque_n_m[-8000:, 2]
        limit, quantum = spacecraft.computer.torque_limit_n_m, spacecraft.computer.torque_quantum_n_m
        rms = float(torque.std())
        rows.append(
            statement_row(
                *("rms of the yaw torque", f"every disturbance, rates 0.5 s old, {which} yaw gains", said, rms, "N m"),
                is_met=rms > 0.5 * limit if factor > 1.0 else rms < 2.0 * quantum,
            )
        )
    return rows


_COLOURS = {"yaw": "#d62728", "roll": "#1f77b4", "pitch": "#2ca02c"}
#: rows of a long flight that are drawn; an angle moves little in a second
_EVERY = 8


def draw_reproduction(kernel: Fly, folder: Path, suffix: str = "png") -> list[Path]:
    """Draw figures 2, 3 and 4 of the paper as the model gives them into a folder; return their paths."""
    yaw, roll = transient_flights(kernel)
    steady = fly_spacecraft(full_spacecraft(kernel), Start(), STABILISATION_S, kernel=kernel)
    named = {
        "orbital-frame-figure-2": (yaw, "Figure 2: yaw of 10 deg at the start"),
        "orbital-frame-figure-3": (roll, "Figure 3: roll of 2 deg at the start"),
        "orbital-frame-figure-4": (steady, "Figure 4: every disturbance, corrected, smallest yaw gains"),
    }
    drawn = []
    for name, (flight, title) in named.items():
        drawn.append(folder / f"{name}.{suffix}")
        _draw(flight, title, drawn[-1])
    return drawn


def _draw(flight: FlightRecord, title: str, path: Path) -> None:
    """Draw the three angles of a flight below one another."""
    # matplotlib costs a second that only figures need
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "svg.hashsalt": "soo"}):
        figure = Figure(figsize=(8.0, 5.5), layout="constrained")
        plots = figure.subplots(3, 1, sharex=True)
        angles = {"yaw": flight.yaw_deg, "roll": flight.roll_deg, "pitch": flight.pitch_deg}
        for plot, (name, angle) in zip(plots, angles.items(), strict=True):
            plot.plot(flight.time_s[::_EVERY], angle[::_EVERY], color=_COLOURS[name], linewidth=0.8)
            plot.set_ylabel(f"{name}, deg")
        plots[0].set_title(title, fontsize=9)
        plots[-1].set_xlabel("s")
        figure.savefig(path, dpi=120, metadata={"Date": None} if path.suffix == ".svg" else None)
