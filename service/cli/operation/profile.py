"""Profile of a user: the service, the key file and the spacecraft of commands that state none.

The file is ``soo/profile.toml`` in the user's configuration folder::

    service = "http://127.0.0.1:8000"
    key_file = "~/.config/soo/operator.key"
    spacecraft = "yamal-202"
"""

import json
import os
import stat
import tomllib
from dataclasses import asdict, dataclass, fields
from pathlib import Path


class ProfileError(Exception):
    """The profile, or the key file that it names, cannot be used."""


@dataclass(frozen=True, slots=True)
class UserProfile:
    """Statements that a user makes once; None: not stated."""

    service: str | None = None
    key_file: Path | None = None
    spacecraft: str | None = None

    def key(self) -> str | None:
        """Return the key, None where no file is named.

        Raises
        ------
        ProfileError
            The file cannot be read, is empty, or others than its owner can read it.
        """
        if self.key_file is None:
            return None
        try:
            mode = stat.S_IMODE(self.key_file.stat().st_mode)
            key = self.key_file.read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            message = f"the key file {self.key_file} of {profile_path()} cannot be read: {error}"
            raise ProfileError(message) from error
        if mode & (stat.S_IRWXG | stat.S_IRWXO):
            message = f"others can read the key file {self.key_file}; run chmod 600 {self.key_file}, then repeat"
            raise ProfileError(message)
        if not key:
            message = f"the key file {self.key_file} is empty; write the key into it"
            raise ProfileError(message)
        return key


def profile_path() -> Path:
    """Return the file of the profile: ``$XDG_CONFIG_HOME/soo/profile.toml`` or ``~/.config/soo/profile.toml``."""
    home = os.environ.get("XDG_CONFIG_HOME")
    return (Path(home) if home else Path.home() / ".config") / "soo" / "profile.toml"


def read_profile() -> UserProfile:
    """Return the user's profile, an empty one where there is no file.

    Raises
    ------
    ProfileError
        The file cannot be read, is no TOML, or states something else than a profile has.
    """
    path = profile_path()
    try:
        stated = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return UserProfile()
    except (OSError, ValueError) as error:
        message = f"the profile {path} cannot be read: {error}; correct or remove it"
        raise ProfileError(message) from error
    known = {each.name for each in fields(UserProfile)}
    wrong = [name for name, value in stated.items() if name not in known or not isinstance(value, str) or not value]
    if wrong:
        message = f"the profile {path}: {', '.join(wrong)}: a profile has {', '.join(sorted(known))}, each a text"
        raise ProfileError(message)
    key_file = stated.get("key_file")
    return UserProfile(
        stated.get("service"),
        None if key_file is None else path.parent / Path(key_file).expanduser(),
        stated.get("spacecraft"),
    )


def write_profile(service: str, key_file: Path, spacecraft: str | None) -> Path:
    """Write the user's profile and return its file; the same content may be written again.

    Raises
    ------
    ProfileError
        A profile exists that states something else: commands would go to another service without notice.
    OSError
        The file cannot be written.
    """
    path, profile = profile_path(), UserProfile(service, key_file.resolve(), spacecraft)
    if path.exists():
        if read_profile() == profile:
            return path
        message = f"the profile {path} states another service, key file or spacecraft; change or remove it by hand"
        raise ProfileError(message)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    # a quoted string of JSON is one of TOML
    stated = ((name, value) for name, value in asdict(profile).items() if value is not None)
    lines = (f"{name} = {json.dumps(str(value), ensure_ascii=False)}\n" for name, value in stated)
    path.write_text("".join(lines), encoding="utf-8")
    return path
