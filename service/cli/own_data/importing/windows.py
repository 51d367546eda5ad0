"""Windows of calibration and alignment that the readings of a folder show."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from service.cli.own_data.importing.entries import field_of
from service.cli.own_data.importing.manifest import FolderManifest, Guess, ReferencesSection, plain_value
from service.cli.own_data.readings import Reading, open_readings
from service.pipeline.config import CalibrationConfig
from service.pipeline.planning.flown_turns import flown_windows
from service.records.epoch import format_epoch

#: mean of readings from which windows are found
_BIN_US = 60_000_000


def proposed_windows(
    folder: Path, entries: list[dict[str, Any]], stated: FolderManifest
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return the windows that readings show; stated ones stay."""
    kept = {name: value for name, value in stated.windows.model_dump(mode="json").items() if value}
    if len(kept) == 3 or not entries:
        return kept, () if kept else ("no readings of a sensor, so no windows",)
    guessed = [name for entry in entries for name, value in entry.items() if isinstance(value, Guess)]
    minutes: dict[int, list[Any]] = {}
    for entry in entries:
        plain = {name: plain_value(value) for name, value in entry.items() if plain_value(value)}
        for reading in readings_of(folder / entry["file"], ReferencesSection.model_validate(plain))():
            if isinstance(reading, Reading):
                # a sensor that gives ten readings a second says no more than one a minute
                minutes.setdefault(reading.epoch_us // _BIN_US, [reading.epoch_us, reading.angles_deg])
    ordered = [minutes[key] for key in sorted(minutes)]
    epochs_us = np.array([each[0] for each in ordered], dtype=np.int64)
    angles_deg = np.array([each[1] for each in ordered], dtype=np.float64).reshape(-1, 3)
    found = flown_windows(epochs_us, angles_deg, CalibrationConfig())
    windows: dict[str, Any] = {
        name: {"start": format_epoch(window.start_us), "stop": format_epoch(window.stop_us)}
        for name, window in (("quiet", found.quiet), ("turns", found.turns), ("align", found.align))
        if window is not None
    }
    if guessed:
        reason = f"found with guesses for {', '.join(dict.fromkeys(guessed))}; propose again once these are stated"
        windows = {name: Guess(window, reason) for name, window in windows.items()}
    return windows | kept, found.shortcomings


def readings_of(path: Path, section: ReferencesSection) -> Callable[[], Iterator[Any]]:
    """Return the readings of an entry, or end where it does not say how they are read."""

    def incomplete(proposal: Any) -> str:
        asked = "; ".join(f"{field_of(each)}: {each.text}" for each in proposal.questions)
        return f"{path}: the manifest must state {asked}"

    return open_readings(path, section.source, section.layout(), incomplete)[0]
