"""A world that stands still: the same carriers in every row."""

from analyzer_sim.emission import Emission, EndOfScenario, Signal

START_US = 1_793_491_200_000_000
ROW_US = 60_000_000
#: about 1017 MHz; their powers are what a test may expect
THREE_CARRIERS = (
    Signal("a", 1012e6, 1e6, 0.25, -40.0),
    Signal("b", 1017e6, 2e6, 0.20, -43.0),
    Signal("c", 1022e6, 0.5e6, 0.35, -46.0),
)
#: the usual 36 MHz
SIXTEEN_CARRIERS = tuple(Signal(f"c{n}", 956e6 + 2e6 * n, 1.2e6, 0.2, -45.0) for n in range(16))


class StandingSource:
    """The same carriers in every row, until the last one if there is one."""

    def __init__(
        self, rows: int | None = 1000, signals: tuple[Signal, ...] = THREE_CARRIERS, noise_dbm_hz: float = -120.0
    ) -> None:
        self.row = 0
        self.rows = rows
        self.signals = signals
        self.noise_dbm_hz = noise_dbm_hz

    @classmethod
    def endless(cls) -> "StandingSource":
        """Sixteen carriers, and no last row."""
        return cls(None, SIXTEEN_CARRIERS, -135.0)

    def advance(self) -> Emission:
        if self.rows is not None and self.row >= self.rows:
            raise EndOfScenario
        self.row += 1
        return self.current()

    def current(self) -> Emission:
        return Emission(START_US + ROW_US * self.row, self.signals, self.noise_dbm_hz)
