"""Keys of the demonstration in files that their owner alone can read: of the administrator, and of two persons."""

from pathlib import Path
from typing import NamedTuple

from service.client.service_client import ServiceClient


class Person(NamedTuple):
    """Somebody who releases torques."""

    name: str
    role: str
    key_file: Path

    @property
    def key(self) -> str:
        """The key of the person's file."""
        return self.key_file.read_text(encoding="ascii").strip()


def two_persons(client: ServiceClient, directory: Path) -> tuple[Person, Person]:
    """Make keys of an operator, who prepares commands, and of an approver, who confirms them.

    Raises
    ------
    ClientError
        The service refused, for one because the key that asks is no administrator's.
    """
    operator, approver = (
        Person(name, role, directory / f"{role}.key") for name, role in (("Anna", "operator"), ("Boris", "approver"))
    )
    for person in (operator, approver):
        made = client.request("POST", "/keys", {"name": person.name, "role": person.role})
        write_key(person.key_file, made["key"])
    return operator, approver


def write_key(path: Path, key: str) -> None:
    """Write a key into a new file of mode 0600; one of an earlier run may have another mode and is removed."""
    path.unlink(missing_ok=True)
    path.touch(0o600, exist_ok=False)
    path.write_text(f"{key}\n", encoding="ascii")
