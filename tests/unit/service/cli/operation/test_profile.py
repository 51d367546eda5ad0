"""The user's profile: written once, read by every command, and never a way for a key to another service."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from service.cli.app import app
from service.cli.operation.profile import ProfileError, UserProfile, profile_path, read_profile, write_profile

URL = "http://127.0.0.1:9"


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    for name in ("SOO_KEY", "SOO_KEY_FILE", "SOO_URL", "SOO_SPACECRAFT"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def key_file(folder: Path, mode: int = 0o600, text: str = "the-key\n") -> Path:
    path = folder / "operator.key"
    path.write_text(text)
    path.chmod(mode)
    return path


def written(text: str) -> Path:
    profile_path().parent.mkdir(parents=True, exist_ok=True)
    profile_path().write_text(text)
    return profile_path()


def test_what_is_written_is_read(home: Path) -> None:
    path = write_profile(URL, key_file(home), "yamal-202")
    assert path == home / "soo/profile.toml"
    assert read_profile() == UserProfile(URL, home / "operator.key", "yamal-202")
    assert read_profile().key() == "the-key"


CHARACTERS = st.characters(codec="utf-8", min_codepoint=1, exclude_characters="/\x7f")


@given(name=st.text(CHARACTERS, min_size=1, max_size=40))
def test_any_name_of_a_file_comes_back(tmp_path_factory: pytest.TempPathFactory, name: str) -> None:
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("config")
        patch.setenv("XDG_CONFIG_HOME", str(folder))
        stated = folder.resolve() / "keys" / f"k{name}"
        write_profile(URL, stated, None)
        assert read_profile() == UserProfile(URL, stated, None)


def test_without_a_file_nothing_is_stated() -> None:
    assert read_profile() == UserProfile()
    assert UserProfile().key() is None


def test_another_profile_is_not_overwritten(home: Path) -> None:
    path = write_profile(URL, key_file(home), None)
    before = path.read_bytes()
    assert write_profile(URL, key_file(home), None) == path
    with pytest.raises(ProfileError, match="states another service"):
        write_profile("http://elsewhere", key_file(home), None)
    assert path.read_bytes() == before


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o620])
def test_a_key_that_others_can_read_is_refused_with_the_command_that_mends_it(home: Path, mode: int) -> None:
    path = key_file(home, mode)
    with pytest.raises(ProfileError, match=f"run chmod 600 {path}"):
        UserProfile(URL, path).key()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("service = ", "cannot be read"),
        ('sevice = "x"', "sevice: a profile has key_file, service, spacecraft"),
        ("spacecraft = 7", "spacecraft: a profile has"),
        ('service = ""', "service: a profile has"),
    ],
)
def test_a_profile_that_is_none_names_file_and_fault(text: str, said: str) -> None:
    path = written(text)
    with pytest.raises(ProfileError, match=said) as caught:
        read_profile()
    assert str(path) in str(caught.value)


def test_an_empty_key_file_and_a_missing_one_are_named(home: Path) -> None:
    with pytest.raises(ProfileError, match="is empty"):
        UserProfile(URL, key_file(home, text="\n")).key()
    with pytest.raises(ProfileError, match="cannot be read"):
        UserProfile(URL, home / "none").key()


class Requests(list):
    """Requests of commands, answered by a service with some spacecraft."""

    spacecraft = ("yamal-202",)


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> Requests:
    from service.client.service_client import ServiceClient

    seen = Requests()

    def request(client: ServiceClient, _method: str, path: str, *_: object, **__: object) -> dict[str, object]:
        seen.append((client.service_url, client._http.headers["Authorization"], path))
        return {"rows": [{"id": name} for name in seen.spacecraft]}

    def replays(client: ServiceClient, spacecraft_id: str) -> list[dict[str, str]]:
        seen.append((client.service_url, client._http.headers["Authorization"], spacecraft_id))
        return [{"version": "replay-1"}]

    monkeypatch.setattr(ServiceClient, "request", request)
    monkeypatch.setattr(ServiceClient, "replays", replays)
    return seen


def run(*options: str, **environment: str):
    return CliRunner().invoke(app, ["replays", "--json", *options], env=environment)


def test_service_key_and_spacecraft_come_from_the_profile(home: Path, requests: Requests) -> None:
    write_profile(URL, key_file(home), "express-80")
    result = run()
    assert json.loads(result.stdout) == {"version": "replay-1"}
    assert requests == [(URL, "Bearer the-key", "express-80")]


def test_options_go_before_the_environment_and_it_before_the_profile(home: Path, requests: Requests) -> None:
    write_profile(URL, key_file(home), "a-1")
    run(SOO_URL="http://127.0.0.1:8", SOO_SPACECRAFT="b-2", SOO_KEY="other")
    run("--service", "http://127.0.0.1:7", "--spacecraft", "c-3", SOO_URL="http://127.0.0.1:8", SOO_KEY="other")
    assert requests == [
        ("http://127.0.0.1:8", "Bearer other", "b-2"),
        ("http://127.0.0.1:7", "Bearer other", "c-3"),
    ]


def test_a_key_of_the_profile_never_goes_to_another_service(home: Path, requests: Requests) -> None:
    write_profile(URL, key_file(home), "a-1")
    result = run("--service", "http://127.0.0.1:7")
    assert (result.exit_code, requests) == (2, [])
    assert "names none for this service" in result.output


def test_the_only_spacecraft_of_a_service_needs_no_name(home: Path, requests: Requests) -> None:
    write_profile(URL, key_file(home), None)
    assert run().exit_code == 0
    assert [path for _, _, path in requests] == ["/spacecraft", "yamal-202"]


@pytest.mark.parametrize(
    ("held", "said"), [(("a-1", "b-2"), "has a-1, b-2: state one with --spacecraft"), ((), "has no spacecraft")]
)
def test_several_spacecraft_or_none_end_the_command(
    home: Path, requests: Requests, held: tuple[str, ...], said: str
) -> None:
    write_profile(URL, key_file(home), None)
    requests.spacecraft = held
    result = run()
    assert (result.exit_code, said in result.output) == (2, True)


def test_a_key_that_others_can_read_ends_the_command(home: Path, requests: Requests) -> None:
    write_profile(URL, key_file(home, 0o644), "a-1")
    result = run()
    assert (result.exit_code, requests) == (2, [])
    assert "chmod 600" in result.output
