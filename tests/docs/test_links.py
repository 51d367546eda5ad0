"""What the documents point at exists: links, anchors, files, tests, commands; and the README stays short."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from service.cli.app import app

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
_FENCE = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
pytestmark = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


def prose(page: Path) -> str:
    """Return a page without its blocks of code."""
    return _FENCE.sub("", page.read_text())


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as code hosts make them."""
    headings = re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        assert "://" not in target, "a link into the world goes stale; name the source in words"
        name, _, anchor = target.partition("#")
        found = (page.parent / name).resolve() if name else page
        assert found.exists(), target
        assert found.is_relative_to(ROOT), target
        if anchor:
            assert anchor in anchors(found), target


def named_paths(page: Path) -> Iterator[tuple[str, str]]:
    """Yield path and test name of each file that a page names."""
    pattern = r"`((?:tests|service|db|analyzer_sim|docs|bench)/[\w./-]+)(?:::(\w+))?`"
    yield from re.findall(pattern, prose(page))


def test_files_and_tests_that_are_named_exist(page: Path) -> None:
    for path, name in named_paths(page):
        assert (ROOT / path).exists(), path
        if name:
            source = (ROOT / path).read_text()
            assert re.search(rf"^(async )?def {name}\(", source, re.MULTILINE), f"{path}::{name}"


def test_commands_and_targets_that_are_named_exist(page: Path) -> None:
    group = typer.main.get_command(app)
    for words in re.findall(r"(?:^\$ |`)soo ([a-z][^`\n]*)", page.read_text(), re.MULTILINE):
        command, options = group, words.split()
        while isinstance(command, typer.core.TyperGroup) and options:
            if command.invoke_without_command and options[0] not in command.commands:
                # it is a command too, and these are its options
                break
            name = options.pop(0)
            assert name in command.commands, f"soo {words}"
            command = command.commands[name]
        # an option that is switched off may have a name of its own
        spelled = [(*parameter.opts, *parameter.secondary_opts) for parameter in command.params]
        known = {option for names in spelled for option in names} | {"--help"}
        assert set(re.findall(r"--[a-z][\w-]*", " ".join(options))) <= known, f"soo {words}"
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    named = re.findall(r"(?:^\$ |`)make ([a-z-]+)", page.read_text(), re.MULTILINE)
    assert set(named) <= set(targets)


def test_no_line_is_wider_than_a_screen(page: Path) -> None:
    wide = [line for line in prose(page).splitlines() if len(line) > 120 and not line.startswith(("|", "![", "    "))]
    assert wide == []


def test_readme_is_short(page: Path) -> None:
    if page.name == "README.md":
        assert len(page.read_text().splitlines()) <= 120


def test_a_page_of_the_documents_stands_in_the_navigation(page: Path) -> None:
    if page.is_relative_to(ROOT / "docs"):
        assert page.relative_to(ROOT / "docs").as_posix() in (ROOT / "mkdocs.yml").read_text()
