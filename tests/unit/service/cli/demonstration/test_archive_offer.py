"""End of an interrupted demonstration: the archive is asked for at a terminal alone, and never overwritten."""

import io
import signal

import pytest
import typer
from rich.console import Console

from service.cli.demonstration import archive_offer
from service.cli.demonstration.archive_offer import offer_archive
from service.cli.demonstration.invitation import program


@pytest.fixture
def directory(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "soo.db").write_text("rows")
    key = folder / "operator.key"
    key.touch(0o600)
    return folder


@pytest.fixture
def answered(monkeypatch):
    """Give a function that plays a terminal where a person answers in turn."""
    former = signal.getsignal(signal.SIGINT)

    def play(*answers):
        left = list(answers)

        def prompt(*_arguments, **_options):
            answer = left.pop(0)
            if answer is None:
                raise typer.Abort
            return str(answer)

        monkeypatch.setattr(archive_offer.typer, "prompt", prompt)
        monkeypatch.setattr(archive_offer.sys.stdin, "isatty", lambda: True, raising=False)

    yield play
    signal.signal(signal.SIGINT, former)


def offered(directory, keep=None, *, is_asked=True, is_terminal=True) -> str:
    out = io.StringIO()
    offer_archive(Console(file=out, width=200, force_terminal=is_terminal), directory, keep, is_asked=is_asked)
    return out.getvalue()


def test_a_named_folder_gets_a_copy_with_the_modes_of_its_keys(directory, answered, tmp_path):
    folder = tmp_path / "kept"
    answered(folder)
    text = offered(directory)
    assert (folder / "soo.db").read_text() == "rows"
    assert (folder / "operator.key").stat().st_mode & 0o777 == 0o600
    key = f'SOO_BOOTSTRAP_KEY="$(cat {folder / "administrator.key"})"'
    assert f"{key} {program()} serve --clock data --database sqlite:///{folder / 'soo.db'}" in text
    assert "database and logs are in" in text


def test_a_folder_that_exists_is_not_written_to(directory, answered, tmp_path):
    taken = tmp_path / "taken"
    taken.mkdir()
    answered(taken, "")
    text = offered(directory)
    assert "not copied" in text
    assert "is removed" in text
    assert list(taken.iterdir()) == []


@pytest.mark.parametrize("answer", ["", None])
def test_nothing_is_kept_without_a_name(directory, answered, answer):
    answered(answer)
    assert "soo demo --keep FOLDER keeps it" in offered(directory)


@pytest.mark.parametrize("options", [{"is_terminal": False}, {"is_asked": False}])
def test_without_a_person_it_says_how_to_keep_it(directory, answered, options):
    answered()
    assert "soo demo --keep FOLDER keeps it" in offered(directory, **options)


def test_a_folder_that_was_to_be_kept_is_named(directory, answered):
    answered()
    (directory / "demonstration.png").touch()
    text = offered(directory, directory)
    assert str(directory / "soo.db") in text
    assert "database, logs and figure are in" in text
