"""What holds for every event kind and limit there is, found by its file."""

from __future__ import annotations

from pathlib import Path

import pytest
from spool_core.events.language import LANGUAGES
from spool_monitor.detectors import DETECTORS, KINDS, LIMITS, MonitorLimit, event_kind, latching_kinds
from spool_monitor.event import EventKind, Namur
from spool_monitor.event_tables import meaning_table, number_table, unknowable_table

ALARMS_PAGE = Path(__file__).resolve().parents[4] / "docs" / "alarms.md"


def test_numbers_are_stable() -> None:
    """Plant systems rely on these numbers: add to them, never change them."""
    promised = {
        "resonance": 100, "friction_drift": 200, "spring_change": 300, "stuck_spool": 400, "stroke": 450,
        "stroke/slower": 451, "stroke/faster": 452, "model_gap": 500,
        "sensor_fault": 600, "data_fault": 700, "stale": 800,
        "friction_drift/wear": 201, "friction_drift/oil_contamination": 202,
        "friction_drift/oil_viscosity": 203, "friction_drift/unknown": 204,
        "friction_drift/oil_or_wear": 205, "friction_drift/sensor_or_friction": 206,
        "spring_change/sensor_or_spring": 303,
        "spring_change/softer": 301, "spring_change/stiffer": 302,
        "sensor_fault/dead": 601, "sensor_fault/clipping": 602, "sensor_fault/offset": 603,
        "sensor_fault/swapped": 604, "sensor_fault/scale": 605, "sensor_fault/same_channel": 606,
        "sensor_fault/wrap_around": 607, "sensor_fault/sensitivity": 608, "sensor_fault/ac_coupling": 609,
        "data_fault/rate": 701, "data_fault/source": 702, "data_fault/lost": 703, "data_fault/malformed": 704,
        "data_fault/outliers": 705, "data_fault/repeats": 706, "data_fault/clock_step": 707,
        "data_fault/clock_drift": 708, "data_fault/overload": 709,
        "data_fault/not_judged": 710, "data_fault/temperature_unit": 711,
        "data_fault/temperature_stamp": 712, "data_fault/temperature_range": 713,
        "stale/acceleration": 801, "stale/estimate": 802, "stale/never_seen": 803,
    }  # fmt: skip
    for name, number in promised.items():
        kind, _, cause = name.partition("/")
        assert event_kind(kind).cause(cause).code == number, name
    assert event_kind("resonance").cause("whatever").code == 100
    assert event_kind("no such kind").code == 900
    assert latching_kinds() == ("stuck_spool", "sensor_fault")


def test_no_number_is_given_twice() -> None:
    numbers = [one.code for kind in KINDS.values() for one in (kind, *kind.causes)]
    assert len(set(numbers)) == len(numbers)


@pytest.mark.parametrize("kind", KINDS.values(), ids=lambda kind: kind.name)
def test_each_kind_and_cause_has_texts_in_every_language_and_a_status(kind: EventKind) -> None:
    told = [kind.cause(one.name) for one in kind.causes] or [kind.cause("")]
    assert all(one.namur > Namur.NORMAL for one in told)
    for language in LANGUAGES.values():
        for texts in (language.event(one.code) for one in told):
            assert texts.title
            assert texts.meaning.endswith(".")
            assert texts.advice
    assert all(kind.code < one.code < kind.code + 100 for one in kind.causes)
    assert kind.task in ("data", "condition")


@pytest.mark.parametrize("name", DETECTORS)
def test_each_detector_raises_a_kind_that_is_declared(name: str) -> None:
    kind = DETECTORS[name].kind
    assert set(kind.causes) <= set(KINDS[kind.name].causes)


@pytest.mark.parametrize("limit", LIMITS.values(), ids=lambda limit: limit.name)
def test_each_limit_has_a_default_in_its_range_and_says_what_it_is(limit: MonitorLimit) -> None:
    assert limit.minimum <= limit.default <= limit.maximum
    assert limit.unit
    assert limit.description.endswith(".")


@pytest.mark.parametrize(
    "table", [number_table, meaning_table, unknowable_table], ids=lambda table: table.__name__
)
def test_the_page_of_alarms_lists_every_number_and_remedy(table: object) -> None:
    """``python -m spool_monitor.event_tables`` brings it up to date."""
    assert callable(table)
    assert table() in ALARMS_PAGE.read_text(encoding="utf-8")
