"""The port of what the release of torques must never forget."""

from typing import Protocol

from service.records.calibration import Window
from service.records.operations.release import Command, ProductForm, ReleaseChange, StoredRelease, UplinkProduct


class Releases(Protocol):
    """State of the release, commands and uplink products of each spacecraft."""

    def stored(self, spacecraft_id: str) -> StoredRelease:
        """Return the newest state; version 0 and an empty document before the first."""

    def save(self, spacecraft_id: str, version: int, change: ReleaseChange) -> int:
        """Store a change and its journal entries in one transaction and return the version that it has.

        ConflictError ``release.changed``: the stored version is another than the one given, or a command or product
        of the same counter says something else; nothing is stored then.
        """

    def command(self, spacecraft_id: str, counter: int) -> Command:
        """Return one command; NotFoundError ``command.unknown``."""

    def commands(
        self,
        spacecraft_id: str,
        window: Window,
        limit: int,
        after: tuple[int, int] | None,
        *,
        newest_first: bool = False,
    ) -> list[Command]:
        """Return commands prepared in a window in order of (prepared, counter) beyond a cursor."""

    def product(self, spacecraft_id: str, form: ProductForm, counter: int) -> UplinkProduct:
        """Return one uplink product; NotFoundError ``uplink.unknown``."""

    def newest_product(self, spacecraft_id: str, form: ProductForm) -> UplinkProduct | None:
        """Return the product of a form with the greatest counter."""
