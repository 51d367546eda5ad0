"""The page of metrics, the dashboard and the alert rules name every metric that there is and none that there is not."""

import json
import re
from pathlib import Path

import yaml

from service.api.monitoring.metric_families import FAMILIES, MAX_CARRIERS, MAX_LINKS, MAX_SOURCES, MAX_SPACECRAFT

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "how-to" / "watch-the-service.md").read_text()
DASHBOARD = ROOT / "deploy" / "grafana" / "soo.json"
RULES = ROOT / "deploy" / "prometheus" / "soo-alerts.yml"
_NAME = re.compile(r"\bsoo_[a-z_]+\b")


def metrics_of(text: str) -> set[str]:
    """Return the metrics that expressions name; parts of a histogram count as the whole."""
    found = set(_NAME.findall(text))
    return {name if name in FAMILIES else re.sub(r"_(bucket|count|sum)$", "", name) for name in found}


def expressions() -> list[str]:
    """Return the expressions of the dashboard and of the rules."""
    panels = json.loads(DASHBOARD.read_text())["panels"]
    shown = [target["expr"] for panel in panels for target in panel["targets"]]
    ruled = re.findall(r"^ +expr: (.+)$", RULES.read_text(), re.MULTILINE)
    assert len(ruled) == RULES.read_text().count("- alert:") >= 12
    return shown + ruled


def test_dashboard_and_rules_name_only_metrics_that_exist() -> None:
    for expression in expressions():
        assert metrics_of(expression), expression
        assert metrics_of(expression) <= FAMILIES.keys(), expression


def test_every_metric_is_on_the_dashboard() -> None:
    panels = json.loads(DASHBOARD.read_text())["panels"]
    shown = metrics_of(" ".join(target["expr"] for panel in panels for target in panel["targets"]))
    assert FAMILIES.keys() - shown == set()


def test_labels_in_expressions_are_those_of_the_metric() -> None:
    for expression in expressions():
        for name, selector in re.findall(r"\b(soo_[a-z_]+)\{([^}]*)\}", expression):
            labels = set(re.findall(r"(\w+)=~?\"", selector))
            assert labels <= set(FAMILIES[re.sub(r"_bucket$", "", name)].labels), expression


def test_grafana_finds_the_dashboard_and_the_source_that_it_asks_for() -> None:
    provisioning = DASHBOARD.parent / "provisioning"
    (source,) = yaml.safe_load((provisioning / "datasources" / "soo.yml").read_text())["datasources"]
    (provider,) = yaml.safe_load((provisioning / "dashboards" / "soo.yml").read_text())["providers"]
    dashboard = json.loads(DASHBOARD.read_text())
    (chooser,) = [each for each in dashboard["templating"]["list"] if each["type"] == "datasource"]
    used = {panel["datasource"]["uid"] for panel in dashboard["panels"]}
    assert (source["type"], used) == (chooser["query"], {f"${{{chooser['name']}}}"})
    assert (source["isDefault"], source["url"], provider["type"]) == (True, "$SOO_PROMETHEUS_URL", "file")
    compose = yaml.safe_load((ROOT / "deploy" / "fleet" / "docker-compose.yml").read_text())["services"]["grafana"]
    mounts = dict(volume.split(":")[:2] for volume in compose["volumes"])
    assert mounts["../grafana/soo.json"] == f"{provider['options']['path']}/{DASHBOARD.name}"
    for kind in ("datasources", "dashboards"):
        path = f"provisioning/{kind}/soo.yml"
        assert mounts[f"../grafana/{path}"] == f"/etc/grafana/{path}"
    assert compose["environment"].keys() == {"SOO_PROMETHEUS_URL"}
    for word in ("deploy/grafana/provisioning/", provider["options"]["path"], "SOO_PROMETHEUS_URL"):
        assert word in PAGE


def test_rules_say_what_to_do() -> None:
    text = RULES.read_text()
    for word in ("summary:", "action:", "severity:", "for:"):
        assert text.count(word) == text.count("- alert:"), word


def test_page_lists_every_metric_as_it_is() -> None:
    text = re.sub(r"\n  ", " ", PAGE)
    rows = re.findall(r"^\* `(soo_\w+)`, (\w+)(?: by ([^:]+))?: (.+)$", text, re.MULTILINE)
    reported = {name: (kind, tuple(re.findall(r"`(\w+)`", labels)), meaning) for name, kind, labels, meaning in rows}
    assert reported == {name: (family.kind, family.labels, family.help) for name, family in FAMILIES.items()}
    assert f"{MAX_SPACECRAFT}, {MAX_SOURCES}, {MAX_CARRIERS} and {MAX_LINKS} are told" in PAGE
