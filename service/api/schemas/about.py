"""The service that answers: its version, clock and settings, and what is installed with it."""

from typing import Literal

from service.api.schemas.base import Answer, EpochAnswer
from service.records.setting import SettingSource


class ClockAnswer(Answer):
    """Clock of the service."""

    now: EpochAnswer
    """The present of the service's system."""
    kind: Literal["system", "data"]
    """`data`: the present of a simulated spacecraft is the newest epoch that it sent."""


class SettingAnswer(Answer):
    """Setting in force; of a secret and of what a URL may hide only that it is set."""

    name: str
    """Environment variable."""
    value: str
    default: str
    unit: str | None
    meaning: str
    origin: str
    """Where the default comes from."""
    source: SettingSource
    """Where the value was read."""


class ShippedAnswer(Answer):
    """Installed distribution."""

    name: str
    version: str
    licence: str | None
    """As its metadata state it; null where they do not."""


class AboutAnswer(Answer):
    """The service that answers."""

    version: str
    python: str
    clock: ClockAnswer
    settings: list[SettingAnswer]
    shipped: list[ShippedAnswer]
    """The program, then what is installed with it."""
