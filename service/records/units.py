"""Units, which stand at the end of names: of fields of the contract, and in capitals of settings."""

#: units by the end of a name, those that end like another one first
_UNITS = {
    "_db_per_deg2": "dB/deg2",
    "_db_per_deg": "dB/deg",
    "_db_per_day": "dB/day",
    "_db_sqrt_h": "dB/sqrt(h)",
    "_db_hz": "dB Hz",
    "_n_m_s": "N m s",
    "_n_m": "N m",
    "_kg_m2": "kg m2",
    "_rad_s2": "rad/s2",
    "_rad_s": "rad/s",
    "_rad": "rad",
    "_rpm": "rpm",
    "_mm_h": "mm/h",
    "_per_s": "1/s",
    "_deg_h": "deg/h",
    "_deg_s": "deg/s",
    "_deg": "deg",
    "_dbm": "dBm",
    "_db": "dB",
    "_hz": "Hz",
    "_days": "days",
    "_bytes": "bytes",
    "_mb": "MB",
    "_h": "h",
    "_s": "s",
    "_m": "m",
}


def unit_of(name: str) -> str | None:
    """Return the unit that a name in small letters ends with; None for counts, shares and words.

    Examples
    --------
    >>> unit_of("yaw_rates_deg_s"), unit_of("carriers_used")
    ('deg/s', None)
    """
    return next((unit for end, unit in _UNITS.items() if name.endswith(end)), None)
