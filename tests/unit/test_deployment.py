"""Deployment files: locks, image, compose files and systemd unit."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
COMPOSE_FILES = ("docker-compose.yml", "deploy/fleet/docker-compose.yml")
CONTAINERS = [
    pytest.param(service, id=f"{name}: {title}")
    for name in COMPOSE_FILES
    for title, service in yaml.safe_load((ROOT / name).read_text())["services"].items()
]
DIGEST = re.compile(r"@sha256:[0-9a-f]{64}$")


def locked(name: str) -> dict[str, set[str]]:
    """Return the versions of every package of a lock file."""
    versions: dict[str, set[str]] = {}
    for package, version in re.findall(r"^([a-z0-9.-]+)(?:\[.*\])?==(\S+)", (ROOT / name).read_text(), re.MULTILINE):
        versions.setdefault(package, set()).add(version)
    return versions


def test_the_service_is_installed_without_figures_cluster_and_data_frames() -> None:
    service, everything = locked("requirements.lock"), locked("requirements-extras.lock")
    extra = {"dask", "distributed", "matplotlib", "pandas", "xarray"}
    assert extra <= everything.keys()
    assert not extra & service.keys()
    assert {name: everything[name] for name in service} == service
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = [*project["dependencies"], *extras["station"], *extras["console"]]
    assert {re.split(r"[\[<>=;]", each)[0] for each in wanted} <= service.keys()
    assert "-r requirements.lock " in (ROOT / "Dockerfile").read_text()


@pytest.mark.parametrize("path", sorted(ROOT.glob("requirements*.lock")), ids=lambda path: path.name)
def test_locks_have_hashes_and_no_address(path: Path) -> None:
    text = path.read_text()
    assert "://" not in text
    packages = re.split(r"^(?=\S)", text, flags=re.MULTILINE)[1:]
    assert all("--hash=sha256:" in package for package in packages)


def test_every_image_is_one_by_its_digest() -> None:
    (base,) = re.findall(r"^FROM (\S+)", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    images = [base, *(service.values[0]["image"] for service in CONTAINERS)]
    foreign = [image for image in images if not image.startswith("soo:")]
    assert len(foreign) == 5
    assert [image for image in foreign if not DIGEST.search(image)] == []


@pytest.mark.parametrize("service", CONTAINERS)
def test_a_container_may_do_no_more_than_it_must(service: dict) -> None:
    confined = {"read_only": True, "cap_drop": ["ALL"], "security_opt": ["no-new-privileges:true"]}
    assert {name: service.get(name) for name in confined} == confined
    assert re.fullmatch(r"\d+g", service["mem_limit"])
    assert 0 < service["pids_limit"] <= 512
    assert "/tmp" in service["tmpfs"]  # noqa: S108 - within the container


@pytest.mark.parametrize("name", COMPOSE_FILES)
def test_secrets_are_files_of_which_the_repository_has_none(name: str) -> None:
    document = yaml.safe_load((ROOT / name).read_text())
    assert all("/secrets/" in secret["file"] for secret in document["secrets"].values())
    for service in document["services"].values():
        assert set(service.get("secrets", ())) <= document["secrets"].keys()
        given = {
            key: value for key, value in service.get("environment", {}).items() if "PASSWORD" in key or "KEY" in key
        }
        for key, value in given.items():
            assert key.endswith("_FILE"), key
            assert value.removeprefix("/run/secrets/") in service["secrets"]


def test_grafana_has_no_default_password() -> None:
    (grafana,) = [service.values[0] for service in CONTAINERS if "grafana/" in service.values[0]["image"]]
    assert grafana["environment"]["GF_SECURITY_ADMIN_PASSWORD__FILE"] == "/run/secrets/grafana_admin_password"
