from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

import pytest

DEFINITIONS = sorted((Path(__file__).resolve().parents[1] / "msg").glob("*.msg"))
NAMES = [path.stem for path in DEFINITIONS]
CONSTANT = re.compile(r"^(\w+) ([A-Z][A-Z0-9_]*) *= *(\d+)")
FIELD = re.compile(r"^([\w/]+(?:\[\])?) +([a-z]\w*)")
#: Fields outsiders rely on: name and type, in this order.
FIXED = {
    "header": "std_msgs/Header",
    "sequence": "uint64",
    "sample_period": "double",
    "body": "sequence<float>",
    "spool": "sequence<float>",
}


def lines(name: str) -> list[str]:
    text = (Path(__file__).resolve().parents[1] / "msg" / f"{name}.msg").read_text("utf-8")
    return [line for line in text.splitlines() if line.strip() and not line.startswith("#")]


def generated(name: str) -> Any:
    return getattr(importlib.import_module("spool_msgs.msg"), name)


def constants(name: str) -> dict[str, int]:
    found = (CONSTANT.match(line) for line in lines(name))
    return {match[2]: int(match[3]) for match in found if match}


def test_the_block_is_what_outsiders_rely_on() -> None:
    assert list(generated("AccelerationBlock").get_fields_and_field_types().items()) == list(FIXED.items())
    assert constants("AccelerationBlock") == {}


def test_every_definition_is_built() -> None:
    listed = (Path(__file__).resolve().parents[1] / "CMakeLists.txt").read_text("utf-8")
    assert sorted(re.findall(r'"msg/(\w+)\.msg"', listed)) == NAMES
    for name in NAMES:
        assert generated(name)().get_fields_and_field_types()
    services = sorted(path.stem for path in (Path(__file__).resolve().parents[1] / "srv").glob("*.srv"))
    assert sorted(re.findall(r'"srv/(\w+)\.srv"', listed)) == services
    for name in services:
        response = getattr(importlib.import_module("spool_msgs.srv"), name).Response
        assert {"success", "reason"} <= set(response.get_fields_and_field_types())


def test_an_alarm_has_a_severity_and_a_status_of_the_other_messages() -> None:
    fields = generated("Alarm").get_fields_and_field_types()
    assert (fields["severity"], fields["namur"], fields["underlying"]) == ("uint8",) * 3


@pytest.mark.parametrize("name", NAMES)
def test_what_is_built_is_what_is_written(name: str) -> None:
    fields = [match[2] for match in map(FIELD.match, lines(name)) if match]
    assert list(generated(name).get_fields_and_field_types()) == fields
    for constant, value in constants(name).items():
        assert getattr(generated(name), constant) == value


@pytest.mark.parametrize("name", NAMES)
def test_each_group_of_constants_has_a_field_and_counts_from_unknown(name: str) -> None:
    fields = generated(name).get_fields_and_field_types()
    groups: dict[str, list[tuple[str, int]]] = {}
    for constant, value in constants(name).items():
        prefix, _, meaning = constant.partition("_")
        groups.setdefault(prefix, []).append((meaning, value))
    for prefix, members in groups.items():
        assert fields[prefix.lower()] == "uint8"
        assert members[0] == ("UNKNOWN", 0)
        assert [value for _, value in members] == list(range(len(members)))
        assert getattr(generated(name)(), prefix.lower()) == 0


@pytest.mark.parametrize("name", NAMES)
def test_every_field_says_what_it_is(name: str) -> None:
    silent = [line for line in lines(name) if FIELD.match(line) and "#" not in line]
    assert silent == []


@pytest.mark.parametrize("name", [name for name in NAMES if name not in ("Quantity", "AccelerationBlocks")])
def test_every_message_of_a_valve_says_when_and_which(name: str) -> None:
    assert next(iter(generated(name).get_fields_and_field_types().items())) == ("header", "std_msgs/Header")


def test_uncertain_numbers_are_quantities() -> None:
    """A bare float is allowed for what is known exactly only."""
    exact = {"sample_period", "delay", "memory", "window", "value", "standard_deviation"}
    # Ends of an interval say the uncertainty, and bounds of samples are samples.
    exact |= {"low", "high", "body_low", "body_high", "spool_low", "spool_high"}
    # An event says its uncertainty once, as the interval of its value; the others follow from what was set
    # and learned (limit, interval between false alarms, baseline) or from the value (change, outlook).
    of_events = {"baseline", "change", "limit", "false_alarm_interval", "time_to_limit"}
    for name in NAMES:
        if name == "ValveDescription":  # given by the user, not determined
            continue
        fields = generated(name).get_fields_and_field_types()
        assert {field for field, kind in fields.items() if kind in ("double", "float")} <= (
            exact | of_events if name == "HealthEvent" else exact
        )


@pytest.mark.parametrize("name", NAMES)
def test_the_readme_names_every_field(name: str) -> None:
    readme = (Path(__file__).resolve().parents[1] / "README.md").read_text("utf-8")
    section = readme.split(f"## {name}\n")[1].split("\n## ")[0]
    for field in generated(name).get_fields_and_field_types():
        assert f"`{field}`" in section, field
    for constant in constants(name):
        assert f"`{constant}`" in section, constant
