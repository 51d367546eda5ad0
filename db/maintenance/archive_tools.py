"""Keeping an archive: backups, their proof, their return, and the doctor, over one URL."""

from collections.abc import Sequence
from pathlib import Path

from db.maintenance.backup import Report, Restored, create_backup, restore_backup, verify_backup
from db.maintenance.doctor import diagnose
from db.maintenance.integrity_check import Report as StepReport
from service.ports.storage import Clock
from service.records.epoch import format_epoch
from service.records.inputs import JournalHead
from service.records.storage import Diagnosis, Manifest


class ArchiveTools:
    """Tools of an operator for an archive, from outside of the service.

    Parameters
    ----------
    url : str
        The archive.
    clock : Clock
        Tells the present.
    fingerprint : str
        Of the checkpoints that fit this program.
    """

    def __init__(self, url: str, clock: Clock, fingerprint: str) -> None:
        self.url = url
        self._clock = clock
        self._fingerprint = fingerprint

    def stamp(self) -> str:
        """Return the present as part of a name, to the second: 20261122T040302Z."""
        text = format_epoch(self._clock.system_us())
        return text.partition(".")[0].replace("-", "").replace(":", "") + "Z"

    def create(self, folder: Path, report: Report) -> Manifest:
        """Make a backup; BackupError."""
        return create_backup(self.url, folder, self._clock.system_us(), report)

    def verify(self, folder: Path, report: Report) -> list[Diagnosis]:
        """Return the findings on a backup; BackupError."""
        return verify_backup(folder, report)

    def restore(self, folder: Path, report: Report, *, may_replace: bool) -> Restored:
        """Put a backup in the place of the archive; BackupError."""
        return restore_backup(folder, self.url, self.stamp(), report, may_replace=may_replace)

    def diagnose(self, report: StepReport, announced: Sequence[JournalHead] = ()) -> list[Diagnosis]:
        """Return the findings on the archive, compared with logged heads of journals."""
        return diagnose(self.url, self._clock.system_us(), report, announced, self._fingerprint)
