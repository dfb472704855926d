"""Metrics for Prometheus: what is served, in its text format, and that the dashboard and the rules fit it."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from prometheus_client.parser import text_string_to_metric_families
from spool_monitor.listener import KEPT_COSTS, Cost, HeardValve, bounds_of
from spool_msgs.msg import Alarm, AlarmList, ValveHealth
from spool_view.application import application
from spool_view.metrics import METRICS, Metrics, estimates_name, exposition
from starlette.testclient import TestClient

from .conftest import OWN, Station, alarm, good_health, quantity, tracking

PAGES = Path(__file__).resolve().parents[5] / "docs" / "metrics"
NOW = time.monotonic()


def heard(name: str = "valve_1") -> HeardValve:
    """Return a hosted valve of which everything is known, with three alarms of two numbers."""
    estimate = tracking()
    estimate.header.stamp.sec, estimate.lost_blocks, estimate.refused_blocks = 1_790_000_000, 7, 2
    alarms = [alarm(), alarm(), alarm()]
    alarms[1].state, alarms[2].state, alarms[2].code = Alarm.STATE_ACKNOWLEDGED, Alarm.STATE_SHELVED, 801
    valve = HeardValve(name, good_health(), NOW, estimate, AlarmList(alarms=alarms))
    valve.limits, valve.cost = {"resonance_band": 0.1}, Cost(12.5, 4e6, NOW)
    valve.health.namur = ValveHealth.NAMUR_FUNCTION_CHECK
    return valve


def read(text: str) -> dict[str, float]:
    """Return each series and its value; checks what a client library's parser lets pass."""
    found: dict[str, float] = {}
    names = []
    for family in text_string_to_metric_families(text):
        names.append(family.name)
        assert family.documentation
        assert family.type in ("gauge", "counter")
        assert re.fullmatch("spool_[a-z0-9_]+", family.name)
        for sample in family.samples:
            assert sample.name == family.name + ("_total" if family.type == "counter" else "")
            labels = ",".join(f"{key}={label}" for key, label in sorted(sample.labels.items()))
            assert f"{sample.name}{{{labels}}}" not in found
            found[f"{sample.name}{{{labels}}}"] = sample.value
    assert len(set(names)) == len(names)
    assert text.endswith("\n")
    assert len(found) == sum(not line.startswith("#") for line in text.splitlines())
    return found


def test_all_of_a_valve_is_served_in_base_units() -> None:
    found = read(
        exposition({"valve_1": heard()}, {"host_1": Cost(3.5, 2e8, NOW)}, NOW + 1.0, 1_790_000_010.0)
    )
    of_valve = {name: value for name, value in found.items() if "valve=valve_1" in name}
    assert of_valve.pop("spool_resonance_margin_ratio{valve=valve_1}") == pytest.approx(21.0 / 28.7 - 1.0)
    kinds = {
        "newtons_per_meter": ("spring_stiffness", 5860.0, 2.0), "newtons": ("coulomb_force", 0.1, 0.005),
        "newton_seconds_per_meter": ("viscous_coefficient", 8.2, 0.1),
        "hertz": ("natural_frequency", 28.7, 0.01),
    }  # fmt: skip
    for unit, (name, value, deviation) in kinds.items():
        for bound, times in (("low", -1.96), ("estimate", 0.0), ("high", 1.96)):
            series = f"spool_estimate_{unit}{{bound={bound},parameter={name},valve=valve_1}}"
            assert of_valve.pop(series) == pytest.approx(value + times * deviation, abs=1e-4 * deviation)
    assert of_valve == {
        "spool_valve_condition{valve=valve_1}": 7.0,
        "spool_valve_namur_status{valve=valve_1}": 4.0,
        "spool_resonance_band_ratio{valve=valve_1}": 0.1,
        "spool_alarms_active{code=100,valve=valve_1}": 2.0,
        "spool_alarms_waiting{code=100,valve=valve_1}": 1.0,
        "spool_alarms_active{code=801,valve=valve_1}": 0.0,
        "spool_alarms_waiting{code=801,valve=valve_1}": 0.0,
        "spool_health_timestamp_seconds{valve=valve_1}": 1_790_000_009.0,
        "spool_block_timestamp_seconds{valve=valve_1}": 1_790_000_000.0,
        "spool_blocks_lost_total{valve=valve_1}": 7.0,
        "spool_blocks_refused_total{valve=valve_1}": 2.0,
        "spool_valve_cpu_seconds_total{valve=valve_1}": 12.5,
        "spool_valve_resident_memory_bytes{valve=valve_1}": 4e6,
    }
    assert found["spool_process_cpu_seconds_total{process=host_1}"] == 3.5
    assert found["spool_process_resident_memory_bytes{process=page}"] > 1e6
    assert found["spool_valves{}"] == 1.0


def test_strokes_of_a_switched_valve_are_served_with_their_limit() -> None:
    valve = heard()
    said = {
        "strokes_today": 412.0,
        "judged_share": 0.63,
        "stroke_time_s": 0.02,
        "stroke_time_healthy_s": 0.018,
    }
    said |= {"stroke_time_healthy_s": 0.018, "stroke_time_high_s": 0.022}
    texts = [KeyValue(key=key, value=str(value)) for key, value in said.items()]
    texts.append(KeyValue(key="stroke_time_judgement", value="judged"))
    status = DiagnosticStatus(name="valve_1/monitor: condition", values=texts)
    valve.bounds = bounds_of([status], "valve_1") or {}
    found = read(exposition({"valve_1": valve}, {}, NOW + 1.0, 1_790_000_010.0))
    assert {name: value for name, value in found.items() if "stroke" in name or "judged" in name} == {
        "spool_strokes_today{valve=valve_1}": 412.0,
        "spool_judged_ratio{valve=valve_1}": 0.63,
        "spool_stroke_seconds{bound=now,parameter=stroke_time,valve=valve_1}": 0.02,
        "spool_stroke_seconds{bound=healthy,parameter=stroke_time,valve=valve_1}": 0.018,
        "spool_stroke_seconds{bound=high,parameter=stroke_time,valve=valve_1}": 0.022,
    }


def test_what_is_not_known_is_not_served() -> None:
    silent = exposition({"valve_1": heard()}, {"host": Cost(3.5, 2e8, NOW)}, NOW + KEPT_COSTS + 1.0, 1e9)
    assert "spool_valve_condition{valve=valve_1}" in read(silent)
    for gone in ("margin", "estimate_", "namur", 'process="host"', "valve_cpu"):
        assert gone not in silent
    unheard = read(exposition({"a": HeardValve("a")}, {}, NOW, 1e9))
    assert [name for name in unheard if "valve=a" in name] == ["spool_valve_condition{valve=a}"]
    unsure = heard()
    assert unsure.estimate is not None
    assert unsure.health is not None
    unsure.estimate.parameters[0].value = float("nan")
    unsure.estimate.parameters[1].validity = 0
    unsure.health.dominant_frequency.value = float("inf")
    found = exposition({"valve_1": unsure}, {}, NOW, 1e9)
    assert not re.search(" (nan|inf)|spring_stiffness|viscous_coefficient|margin_ratio", found)


def test_names_and_units_of_others_can_add_no_line() -> None:
    strange = heard()
    assert strange.estimate is not None
    strange.estimate.parameters = [
        quantity('a"} 1\nspool_valves 9\\', "N\n# TYPE spool_valves counter", 1.0),
        quantity("twice", "Ω", 1.0),
        quantity("twice", "Ω", 2.0),
        *(quantity(f"p{number}", "N", 1.0) for number in range(1000)),
    ]
    found = read(exposition({"valve_1": strange}, {}, NOW, 1e9))
    assert found["spool_valves{}"] == 1.0
    assert len(found) < 80
    assert any('parameter=a"} 1\nspool_valves 9\\' in name for name in found)


def test_a_hundred_valves_are_few_series() -> None:
    valves = {name: heard(name) for name in (f"press/valve_{number}" for number in range(100))}
    found = read(exposition(valves, {f"host_{number}": Cost(1.0, 1.0, NOW) for number in range(8)}, NOW, 1e9))
    assert len(found) < 300 + 25 * 100


def test_they_are_served_on_request_only_and_to_this_hosts_names_only(station: Station) -> None:
    assert station.client.get("/metrics").status_code == 404
    desk = replace(station.desk, metrics=Metrics(station.desk.valves, {}))
    client = TestClient(application(desk).asgi, base_url=OWN)
    answer = client.get("/metrics")
    assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    assert "spool_alarms_waiting{code=100,valve=valve_1}" in read(answer.text)
    assert client.get("/metrics", headers={"host": "evil.example"}).status_code == 421
    assert client.get("/metrics", headers={"origin": "http://evil.example"}).status_code == 403
    assert client.post("/metrics", headers={"origin": OWN}).status_code == 405


def served_names() -> set[str]:
    """Return every name that is served of usual models."""
    return {*METRICS, *(estimates_name(one.unit) for one in tracking().parameters), estimates_name("Hz")}


def names_in(expression: str) -> set[str]:
    return set(re.findall(r"\bspool_[a-z0-9_]+", expression))


def test_rules_and_dashboard_use_metrics_that_are_served() -> None:
    (group,) = yaml.safe_load((PAGES / "rules.yaml").read_text("utf-8"))["groups"]
    assert len({rule["alert"] for rule in group["rules"]}) == 6
    for rule in group["rules"]:
        assert rule["annotations"]["summary"]
        assert rule["annotations"]["description"]
        assert names_in(rule["expr"]) <= served_names()
    panels = json.loads((PAGES / "dashboard.json").read_text("utf-8"))["panels"]
    used = [names_in(target["expr"]) for panel in panels for target in panel.get("targets", [])]
    assert all(used)
    assert set().union(*used) <= served_names()


UP, CONDITION, WAITS = (
    'up{job="spool"}',
    'spool_valve_condition{valve="v"}',
    'spool_alarms_waiting{valve="v"}',
)
MARGIN, BAND_RATIO = (f'spool_resonance_{name}_ratio{{valve="v"}}' for name in ("margin", "band"))
LOST, REFUSED = (f'spool_blocks_{name}_total{{valve="v"}}' for name in ("lost", "refused"))
#: Alert, series by minute, the minute that is looked at, and whether it fires then.
HISTORIES: tuple[tuple[str, dict[str, list[float | None]], int, bool], ...] = (
    ("SpoolPageDown", {UP: [1, 0, 0, 0, 0]}, 4, True),
    ("SpoolPageDown", {UP: [1, 1, 1, 1, 1]}, 4, False),
    ("SpoolPageDown", {"spool_valves": [1, 1, 1, 1, 1]}, 4, True),
    ("SpoolValveSilent", {CONDITION: [0, 6, 6, 6, 6]}, 4, True),
    ("SpoolValveSilent", {CONDITION: [0, 0, 5, 5, 5]}, 4, True),
    ("SpoolValveSilent", {CONDITION: [0, 6, 0, 6, 0]}, 4, False),
    ("SpoolValveSilent", {CONDITION: [0, 8, 8, 8, 8]}, 4, False),
    ("SpoolValveAlarm", {CONDITION: [0, 7, 7, 7, 7]}, 4, True),
    ("SpoolValveAlarm", {CONDITION: [4, 4, 4, 4, 4]}, 4, False),
    ("SpoolAlarmWaits", {WAITS: 40 * [1.0]}, 35, True),
    ("SpoolAlarmWaits", {WAITS: 20 * [1.0] + 20 * [0.0]}, 35, False),
    ("SpoolNearResonance", {MARGIN: 5 * [-0.05], BAND_RATIO: 5 * [0.1]}, 4, True),
    ("SpoolNearResonance", {MARGIN: 5 * [-0.2], BAND_RATIO: 5 * [0.1]}, 4, False),
    ("SpoolBlocksLost", {LOST: [4.0 * n for n in range(12)], REFUSED: 12 * [0.0]}, 11, True),
    ("SpoolBlocksLost", {LOST: 12 * [7.0], REFUSED: 12 * [0.0]}, 11, False),
)


def rules() -> dict[str, Any]:
    (group,) = yaml.safe_load((PAGES / "rules.yaml").read_text("utf-8"))["groups"]
    return {rule["alert"]: rule for rule in group["rules"]}


def holds(expression: str, series: Mapping[str, list[float | None]], minute: int) -> bool:
    """Return whether an expression of the rules holds, by own reading of what they use of PromQL."""
    named = {name.partition("{")[0]: values for name, values in series.items()}

    def value(name: str, ago: int = 0) -> float:
        values = named.get(name, [])
        found = values[max(0, minute - ago)] if minute < len(values) else None
        return math.nan if found is None else float(found)

    text = re.sub(r"\{[^}]*\}", "", expression)
    text = re.sub(r"increase\((\w+)\[(\d+)m\]\)", r"(value('\1') - value('\1', \2))", text)
    text = re.sub(r"absent\((\w+)\)", r"math.isnan(value('\1'))", text)
    text = re.sub(r"(?<!')\b(spool_\w+|up)\b(?!')", r"value('\1')", text)
    return bool(eval(text, {"value": value, "math": math, "abs": abs}))


def test_a_valve_that_has_never_spoken_has_the_series_that_a_rule_fires_on() -> None:
    found = read(exposition({"press/left": HeardValve("press/left")}, {}, NOW, 1e9))
    assert found["spool_valve_condition{valve=press/left}"] == 6.0
    assert found["spool_valves{}"] == 0.0
    silent = {"spool_valve_condition": [found["spool_valve_condition{valve=press/left}"]]}
    assert holds(rules()["SpoolValveSilent"]["expr"], silent, 0)


@pytest.mark.parametrize(("alert", "series", "minute", "fires"), HISTORIES)
def test_rules_fire_on_what_they_are_for(
    alert: str, series: dict[str, list[float | None]], minute: int, *, fires: bool
) -> None:
    rule = rules()[alert]
    lasting = math.ceil(float(rule.get("for", "0m").rstrip("ms")) / (60 if "s" in rule.get("for", "") else 1))
    assert all(holds(rule["expr"], series, minute - n) for n in range(lasting + 1)) is fires


@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not installed")
def test_promtool_agrees_on_when_rules_fire(tmp_path: Path) -> None:
    """Prometheus' own evaluation of the same histories; the one above reads the expressions by itself."""
    tests = []
    for alert, series, minute, fires in HISTORIES:
        tests.append(
            {
                "interval": "1m",
                "input_series": [
                    {"series": name, "values": " ".join("_" if one is None else f"{one:g}" for one in values)}
                    for name, values in series.items()
                ],
                "promql_expr_test": [
                    {
                        "expr": f'count(ALERTS{{alertname="{alert}",alertstate="firing"}})',
                        "eval_time": f"{minute}m",
                        "exp_samples": [{"labels": "{}", "value": 1}] if fires else [],
                    }
                ],
            }
        )
    (tmp_path / "rules.yaml").write_text((PAGES / "rules.yaml").read_text("utf-8"), "utf-8")
    (tmp_path / "test.yaml").write_text(
        yaml.safe_dump({"rule_files": ["rules.yaml"], "evaluation_interval": "15s", "tests": tests}), "utf-8"
    )
    done = subprocess.run(
        ["promtool", "test", "rules", "test.yaml"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
