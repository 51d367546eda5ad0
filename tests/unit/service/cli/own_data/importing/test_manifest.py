"""Manifests: what a person writes into them, and what is refused."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer import Exit

from service.cli.own_data.importing.manifest import (
    NAME,
    Guess,
    PowersSection,
    read_manifest,
    read_stated,
    write_manifest,
)

TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=("C",)), min_size=1, max_size=20).filter(str.strip)
TABLE = """\
powers:
- {file: levels.csv, source: sa-1, tz: +10:00, unit: dBW, carriers: {On: c00, 0123: c01, 2026-01-01: c02}}
windows:
  turns: {start: 2026-10-08T00:00:00+03:00, stop: '2026-10-08T08:00:00Z'}
"""


def written(folder: Path, text: str) -> Path:
    """Return a folder with a manifest."""
    (folder / NAME).write_text(text)
    return folder


def test_texts_that_yaml_would_take_for_something_else_stay_texts(tmp_path: Path) -> None:
    manifest = read_manifest(written(tmp_path, TABLE))
    (powers,) = manifest.powers
    assert (powers.tz, dict(powers.carriers)) == ("+10:00", {"On": "c00", "0123": "c01", "2026-01-01": "c02"})
    assert manifest.windows.turns is not None
    assert manifest.windows.model_dump(mode="json")["turns"]["start"] == "2026-10-07T21:00:00.000000Z"


@given(st.dictionaries(TEXTS, TEXTS, max_size=4), TEXTS, st.sampled_from(["UTC", "+10:00", "-03:30", "no", "1e3"]))
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, carriers: dict[str, str], file: str, tz: str
) -> None:
    folder = tmp_path_factory.mktemp("folder")
    entry = {"file": file, "source": "sa-1", "tz": tz, "carriers": carriers}
    write_manifest(folder, {"carriers": file, "powers": [entry]})
    manifest = read_manifest(folder)
    assert manifest.carriers == file
    assert manifest.powers == (PowersSection.model_validate(entry),)


def test_guesses_are_refused_by_line_and_left_out_of_what_is_stated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = {"file": "levels.csv", "source": "sa-1", "tz": Guess("UTC", "no offset"), "unit": "dBm"}
    write_manifest(tmp_path, {"powers": [entry], "windows": {"turns": Guess({"start": "a", "stop": "b"}, "unsure")}})
    text = (tmp_path / NAME).read_text()
    assert "# levels.csv.tz: no offset" in text
    with pytest.raises(Exit) as ended:
        read_manifest(tmp_path)
    assert ended.value.exit_code == 2
    said = capsys.readouterr().err
    line = text.splitlines().index("  tz: !guess 'UTC'") + 1
    assert f"line {line}: powers levels.csv.tz: UTC" in said
    assert "windows.turns" in said
    stated = read_stated(tmp_path)
    assert (stated.powers[0].unit, stated.powers[0].tz, stated.windows.turns) == ("dBm", None, None)
    written(
        tmp_path, text.replace("!guess ", "").replace("!guess", "").replace("start: a", "start: 2026-01-01T00:00:00Z")
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("powers: [", "is no YAML"),
        ("- a\n", "is no manifest"),
        ("", "is no manifest"),
        ("carriers: a.csv\ncarriers: b.csv\n", "'carriers' occurs twice"),
        ("powers: &a []\nreferences: *a\n", "has no aliases"),
        ("carriers: !!python/name:os.system\n", "is no YAML"),
        ("colour: red\n", "/colour: unknown field"),
        ("powers: [{file: a, source: b, unit: W}]\n", "/powers/0/unit"),
        ("powers: [{source: b}]\n", "/powers/0/file: this field is required"),
        ("windows: {quiet: {start: yesterday, stop: today}}\n", "/windows/quiet/start: 'yesterday' is not"),
    ],
)
def test_what_is_no_manifest_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    with pytest.raises(Exit) as ended:
        read_manifest(written(tmp_path, text))
    assert ended.value.exit_code == 2
    assert said in capsys.readouterr().err


def test_a_folder_without_a_manifest_says_how_to_make_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(Exit):
        read_manifest(tmp_path)
    assert "--propose" in capsys.readouterr().err
    assert read_stated(tmp_path).powers == ()
