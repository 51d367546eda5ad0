"""Quality flags of one carrier in one measurement: what the front end and the service know about a level.

Bits up to 1024 are the station's exchange format; those above are the front end's own findings. Flags are stored with
the level and never replace it: whether a flagged level is used is decided by the estimator.
"""

from enum import IntFlag


class QualityFlag(IntFlag):
    """Bit mask that goes with every level."""

    #: the clock behind the epoch is not synchronised
    CLOCK_UNSYNC = 1
    #: the row came late or out of order
    LATE = 2
    #: the analyzer's input or converter was overdriven
    OVERRANGE = 4
    #: the analyzer says the sweep is not calibrated, for example too fast for its bandwidth
    UNCAL = 8
    #: no carrier found: the level is absent, never the noise
    NO_CARRIER = 16
    #: the carrier's bandwidth or level changed by traffic
    TRAFFIC_CHANGE = 32
    #: a foreign signal lies in the band
    INTERFERENCE = 64
    #: the level falls as rain makes it fall
    RAIN_FADE_SUSPECT = 128
    #: the level is older than its validity
    EXPIRED = 256
    #: the level comes from a simulation
    SIMULATED = 512
    #: the level was computed again from a kept trace
    REPROCESSED = 1024
    #: the analyzer's settings were not those that were asked for
    SETTING_MISMATCH = 2048
    #: the analyzer gave the same trace again
    STALE_TRACE = 4096
    #: the trace held values that are not numbers
    NONFINITE_VALUE = 8192
    #: a neighbour lies within two resolution bandwidths or leaks more than 0.1 dB into the band
    NEIGHBOUR = 16384
    #: a noise window held a signal
    NOISE_WINDOW_DIRTY = 32768
    #: the noise floor is the analyzer's own
    DANL_LIMITED = 65536
    #: carrier over noise in the symbol rate below 3 dB
    LOW_C_N = 131072
    #: the carrier's centre is more than a tenth of the symbol rate off
    FREQUENCY_OFFSET = 262144
    #: a sweep of the cycle failed; carriers of the other sweeps are good
    PARTIAL_CYCLE = 524288
    #: first row after the connection to the analyzer was lost
    RECONNECTED = 1048576
    #: the analyzer's reference oscillator is not locked
    REFERENCE_UNLOCKED = 2097152
    #: the carrier stands in the plan but not in the measurement task
    NOT_MEASURED = 4194304
    #: the row was measured within a leap second, or its epoch gave way by 1 us to a row that was
    LEAP_SECOND = 8388608


def flag_names(mask: int) -> list[str]:
    """Return the names of the flags of a bit mask, lowest bit first; a bit without a name is told by its number.

    Examples
    --------
    >>> flag_names(16 | 4096 | 1 << 30)
    ['NO_CARRIER', 'STALE_TRACE', 'BIT_30']
    """
    bits = (bit for bit in range(mask.bit_length()) if mask >> bit & 1)
    return [_NAMES.get(1 << bit, f"BIT_{bit}") for bit in bits]


_NAMES = {flag.value: flag.name for flag in QualityFlag if flag.name is not None}
