"""What is shown of a valve: green only where all is known; intervals against baseline and limits."""

from __future__ import annotations

import json
import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from spool_core.block import Block
from spool_core.events.event import Event, EventState
from spool_core.events.event import Severity as MonitorSeverity
from spool_core.uncertainty import Quantity as Measured
from spool_core.uncertainty import Validity
from spool_estimator.estimate import Estimate, State
from spool_monitor.alarm_store import serialised
from spool_monitor.detectors import DETECTORS, JUDGEMENT_TEXTS, MonitorSettings
from spool_monitor.journal import Journal, JournalEntry
from spool_monitor.listener import DRIFT, HeardValve, bounds_of, condition_of
from spool_monitor.monitor import Monitor
from spool_monitor.monitor_node import condition_status
from spool_monitor.shown import MOST, STATES
from spool_monitor.state_database import FILE
from spool_monitor.state_file import valve_folder
from spool_monitor.trend import Sums, TrendStore
from spool_msgs.msg import AlarmList, GapAnalysis, ModelEstimate, Quantity, ValveHealth
from spool_msgs.srv import ManageBaseline
from spool_view.acts import RateLimit
from spool_view.application import LANGUAGES, SITE, language_of
from spool_view.channels import BROKEN, waterfall_of
from spool_view.kept import history
from spool_view.view import AT_REST, alarms_of, detail_of, limits_of, row_of, shown, spectrum_of, trend_of

from .conftest import alarm, good_health, quantity, tracking


def valve(**health: object) -> HeardValve:
    made = HeardValve("v", good_health(), 100.0)
    for name, value in health.items():
        setattr(made.health, name, value)
    return made


@pytest.mark.parametrize(
    ("level", "baseline", "friction", "now", "condition"),
    [
        (1, 2, "judged", 100.5, "good"),
        (1, 2, "judged", 102.6, "no_word"),
        (1, 2, "no data yet", 100.5, "unknown"),
        (1, 2, "not judged", 100.5, "unknown"),
        (1, 2, "something new", 100.5, "unknown"),
        (1, 2, "learning", 100.5, "learning"),
        (1, 1, "judged", 100.5, "learning"),
        (1, 0, "judged", 100.5, "learning"),
        (1, 2, "not enough excitation", 100.5, "at_rest"),
        (0, 2, "judged", 100.5, "unknown"),
        (77, 2, "judged", 100.5, "unknown"),
        (2, 2, "judged", 100.5, "warning"),
        (3, 2, "learning", 100.5, "alarm"),
        (4, 2, "judged", 100.5, "stale"),
        (3, 2, "judged", 109.0, "no_word"),
    ],
)
def test_a_valve_is_good_only_where_all_is_known_and_heard_lately(
    level: int, baseline: int, friction: str, now: float, condition: str
) -> None:
    judgements = ["resonance: judged", f"friction_drift: {friction}", "spring_change: judged"]
    one = valve(level=level, baseline=baseline, judgements=judgements)
    assert one.condition(now) == condition
    assert condition_of(None, 0.0) == "no_word"


def test_a_valve_whose_drift_nobody_judges_is_not_good() -> None:
    assert condition_of(valve(judgements=["resonance: judged"]).health, 0.0) == "unknown"


def test_the_words_of_the_monitor_are_those_that_are_understood() -> None:
    assert set(DRIFT) <= set(DETECTORS)
    assert {"judged", "learning", "not enough excitation"} <= set(JUDGEMENT_TEXTS.values())


def test_the_margin_to_resonance_says_which_side() -> None:
    assert row_of(valve(), 100.0)["margin"] == round(100 * (21.0 / 28.7 - 1))
    unknown = quantity("dominant_frequency", "Hz", math.nan, math.nan, Quantity.VALIDITY_UNKNOWN)
    assert row_of(valve(dominant_frequency=unknown), 100.0)["margin"] is None
    rest = row_of(valve(judgements=[AT_REST]), 100.0)
    assert (rest["margin"], rest["shakes"]) == (None, None)
    silent = row_of(valve(), 110.0)
    assert (silent["margin"], silent["shakes"], silent["natural"], silent["summary"]) == (None,) * 4


def test_the_viscous_coefficient_is_compared_at_the_reference_temperature() -> None:
    one = valve()
    one.estimate = tracking()
    one.estimate.referred_viscous_coefficient = quantity("referred_viscous_coefficient", "N s/m", 10.0, 0.1)
    one.baseline = ManageBaseline.Response(success=True)
    one.baseline.values = [quantity("viscous_coefficient", "N s/m", 8.0, 0.05)]
    assert detail_of(one, 100.0)["estimate"]["parameters"][1]["change"] == 25.0


def test_what_is_not_known_is_no_number() -> None:
    unknown = shown(Quantity(name="x", unit="N", value=math.nan, standard_deviation=math.nan))
    assert (unknown["text"], unknown["value"], unknown["validity"]) == (None, None, "unknown")
    held = shown(quantity("x", "N", 2.0, math.nan, Quantity.VALIDITY_HELD))
    assert (held["text"], held["half"], held["validity"]) == ("2.000", None, "held")


def test_alarms_that_are_not_normal_are_shown_with_their_states() -> None:
    many = [alarm(f"a{n}") for n in range(MOST + 40)]
    many[0].state = 1
    found = alarms_of(AlarmList(alarms=many))
    assert len(found) == MOST
    assert found[0]["name"] == "a1"
    assert found[0]["state"] == "unacknowledged"
    long = alarms_of(AlarmList(alarms=[alarm(note="x" * 100_000)]))[0]
    for code in ("en", "de", "pl"):
        assert max(len(text) for _, text in long["texts"][code]["details"]) == 2000
    assert long["texts"]["en"]["headline"] == "Resonance: amplification 4.2, limit 3.6"


def test_browsers_get_every_value_of_a_valve() -> None:
    """Of each quantity its value and 1.96 standard deviations, here of a hundredth of it."""

    def number(name: str, value: float, unit: str = "1") -> Quantity:
        return quantity(name, unit, value, 0.01 * value)

    others = ("natural_frequency", "damping_ratio", "oil_temperature", "residual", "excitation")
    health = good_health("wears", 24.0)
    health.namur, health.natural_frequency = ValveHealth.NAMUR_FUNCTION_CHECK, number("natural", 30.0, "Hz")
    health.amplification = number("amplification", 3.0)
    one = HeardValve("v", health, 100.0)
    one.estimate = ModelEstimate(
        model="stribeck", state=ModelEstimate.STATE_NOT_EXCITED,
        parameters=[number("mass", 0.2, "kg"), number("force", 0.5, "N")],
        lost_blocks=7, refused_blocks=5, relative_displacement=number("relative_displacement", 4e-4, "m"),
        **{name: number(name, 11.0 + place) for place, name in enumerate(others)},
    )  # fmt: skip
    one.baseline = ManageBaseline.Response(
        success=True, version=4, stage="frozen", valve_id="A-12", oil="HL68", frozen_by="Eva",
        values=[number("mass", 0.16, "kg")],
    )  # fmt: skip
    one.gap = GapAnalysis(
        state=GapAnalysis.STATE_DONE, verdict="play", sentence="It has play.", window=60.0, json="{}",
        confidence=number("confidence", 0.9),
    )  # fmt: skip
    one.gap.header.stamp.sec, one.limits = 42, {"resonance_band": 0.15}
    one.bounds = {"mass_low_kg": 0.1, "mass_high_kg": 0.3, "force_low_N": math.nan}
    detail = detail_of(one, 100.0)
    estimate, resonance = detail.pop("estimate"), detail.pop("resonance")
    assert detail == {
        "name": "v", "condition": "good", "rank": (8, 0), "reason": None, "since": None,
        "waiting": 0, "margin": -20, "band": 15.0, "letter": "C",
        "shakes": "24.0", "natural": "30.0", "summary": "wears", "alarms": [],
        "judgements": ["resonance: judged", "friction_drift: judged", "spring_change: judged"],
        "baseline": {"version": 4, "stage": "frozen", "valve_id": "A-12", "oil": "HL68", "frozen_by": "Eva"},
        "gap": {
            "done": True, "verdict": "play", "confidence": 0.9, "sentence": "It has play.", "window": 60.0,
            "stamp": 42, "report": True,
        },
    }  # fmt: skip
    assert (resonance["margin"], resonance["band"]) == (-20, 15.0)
    assert [resonance[name]["value"] for name in ("shakes", "natural", "amplification")] == [24.0, 30.0, 3.0]
    assert [estimate[name] for name in ("model", "state", "lost", "refused")] == [
        "stribeck", "not_excited", 7, 5,
    ]  # fmt: skip
    values = {each["name"]: (each["value"], each["width"], each["unit"]) for each in estimate["others"]}
    assert values == {
        **{
            name: (11.0 + n, pytest.approx(0.0196 * (11.0 + n), rel=1e-4), "1")
            for n, name in enumerate(others)
        },
        "relative_displacement": (0.4, pytest.approx(0.00784, rel=1e-4), "mm"),
    }
    mass, force = estimate["parameters"]
    assert (mass["value"], mass["baseline"]["value"], mass["low"], mass["high"]) == (0.2, 0.16, 0.1, 0.3)
    assert (mass["text"], mass["half"]) == ("0.2000", "0.0039")
    assert (force["baseline"], force["low"], force["high"]) == (None, None, None)
    assert detail_of(one, 200.0)["estimate"]["state"] == "stale"
    assert (mass["change"], mass["compared"], mass["validity"]) == (25.0, None, "valid")


def test_browsers_get_every_value_of_an_event_in_the_history(tmp_path: Path) -> None:
    path, now = valve_folder(tmp_path, "valve_1") / FILE, int(time.time())
    path.parent.mkdir(parents=True)
    journal = Journal(path)
    raised = JournalEntry((now - 60) * 10**9, "raise", "stuck_spool", 400, "F", "alarm", "unacknowledged", 3)
    seen = replace(raised, stamp=(now - 50) * 10**9, action="shelve", who="Eva", comment="wait", text="Stuck")
    journal.write([raised, seen])
    journal.close()
    found = history(tmp_path, ["valve_1"], "eva", (0, time.time_ns()), "en")
    assert (found["count"], found["entries"]) == (1, [{
        "time": now - 50, "valve": "valve_1", "action": "shelve", "alarm": "stuck_spool", "code": 400,
        "who": "Eva", "comment": "wait", "text": "Stuck",
    }])  # fmt: skip
    (often,) = found["frequent"]
    assert often == {
        "valve": "valve_1", "alarm": "stuck_spool", "code": 400, "count": 1, "share": "100",
    }  # fmt: skip


def test_a_raised_alarm_in_the_history_leads_to_its_recording(tmp_path: Path) -> None:
    path, stamp = valve_folder(tmp_path, "press/valve_1") / FILE, 1_767_323_045_000_000_000
    path.parent.mkdir(parents=True)
    event = Event(
        stamp, "resonance", EventState.RAISED, MonitorSeverity.ALARM, "",
        Measured("amplification", "1", 4.2, 0.1, Validity.VALID), code=100,
    )  # fmt: skip
    journal = Journal(path)
    journal.write([
        JournalEntry(stamp + second * 10**9, "raise", "resonance", 100, event=kept)
        for second, kept in ((5, json.dumps(serialised(asdict(event)))), (9, ""))
    ])  # fmt: skip
    journal.close()
    unknown, known = history(tmp_path, ["press/valve_1"], "", (0, time.time_ns()), "en")["entries"]
    assert known["snapshot"] == "press_valve_1_resonance_20260102T030405Z"
    assert known["advice"].startswith("change the machine's speed")
    assert (unknown["snapshot"], unknown["advice"]) == ("", known["advice"])


def test_the_history_has_what_lies_between_two_days(tmp_path: Path, make_station: Callable[..., Any]) -> None:
    path = valve_folder(tmp_path, "valve_1") / FILE
    path.parent.mkdir(parents=True)
    journal = Journal(path)
    day = 1_790_000_000
    one = JournalEntry(day * 10**9, "raise", "stuck_spool", 400, "F", "alarm", "unacknowledged", 3)
    journal.write([replace(one, stamp=(day + 86400 * number) * 10**9) for number in range(3)])
    journal.close()
    client = make_station().client
    asked = {"since": str(day + 86400), "until": str(day + 2 * 86400)}
    found = client.get("/history.json", params=asked).json()
    assert [one["time"] for one in found["entries"]] == [day + 86400]
    assert len(client.get("/history.csv", params=asked).text.splitlines()) == 2
    assert client.get("/history.json", params={"since": "-1"}).status_code == 400


def block(sequence: int, period: float = 0.001, size: int = 100, frequency: float = 25.0) -> Block:
    time_ = (sequence * size + np.arange(size)) * period
    body = (3.0 * np.sin(2 * np.pi * frequency * time_)).astype(np.float32)
    return Block(10**18 + sequence * 100_000_000, sequence, period, body, 2.0 * body)


def test_a_sine_of_3_is_a_line_of_3_in_the_spectrum() -> None:
    found = spectrum_of([block(n) for n in range(30)])
    assert found is not None
    peak = int(np.argmax(found["body"]))
    assert peak * found["step"] == pytest.approx(25.0)
    assert found["body"][peak] == pytest.approx(3.0, rel=0.01)
    assert found["spool"][peak] == pytest.approx(6.0, rel=0.01)
    assert len(found["body"]) <= 400


def test_gaps_and_nonsense_in_samples_give_no_spectrum() -> None:
    assert spectrum_of([]) is None
    assert spectrum_of([block(n) for n in (1, 2, 3, 9)]) is None
    assert spectrum_of([block(n, period=0.0) for n in range(30)]) is None
    assert spectrum_of([block(n, period=math.nan) for n in range(30)]) is None
    broken = [block(n) for n in range(30)]
    broken[-1].body[3] = math.nan
    assert spectrum_of(broken) is None


def test_trends_are_read_as_the_monitor_keeps_them(tmp_path: Path) -> None:
    path = valve_folder(tmp_path, "press/left") / "trends.sqlite"
    path.parent.mkdir(parents=True)
    store, sums, now = TrendStore(path), Sums(), int(time.time())
    for ago in range(0, 7200, 10):
        sums.add((now - ago) * 1_000_000_000, "coulomb_force", "N", 0.1 + ago * 1e-5)
    store.write(sums)
    store.close()
    found = trend_of(tmp_path, "press/left", "", "hour")
    assert (found["parameter"], found["unit"], found["seconds"]) == ("coulomb_force", "N", 60)
    assert 59 <= len(found["start"]) <= 62
    assert found["minimum"][-1] == pytest.approx(0.1)
    assert trend_of(tmp_path, "press/left", "coulomb_force", "year")["seconds"] == 86400
    assert len(trend_of(tmp_path, "press/left", "coulomb_force", "all")["start"]) > 100


@pytest.mark.parametrize(
    ("chosen", "accepted", "language"),
    [
        ("", "", "en"),
        ("", "de-AT,de;q=0.9,en;q=0.5", "de"),
        ("", "fr,de;q=0.3,en;q=0.8", "en"),
        ("en", "de", "en"),
        ("xx", "fr", "en"),
        ("", "de;q=0,en;q=0.1", "en"),
        ("", "de;q=x", "en"),
        ("", "," * 10_000, "en"),
    ],
)
def test_the_language_is_that_chosen_or_accepted(chosen: str, accepted: str, language: str) -> None:
    assert language_of(chosen, accepted) == language


def test_both_languages_say_everything() -> None:
    def keys(one: object) -> object:
        return {name: keys(value) for name, value in one.items()} if isinstance(one, dict) else None

    texts = [json.loads((SITE / f"texts_{code}.json").read_text(encoding="utf-8")) for code in LANGUAGES]
    assert keys(texts[0]) == keys(texts[1])
    assert set(texts[0]["conditions"]) == set(texts[0]["meanings"]) == set(STATES)


def test_a_rate_is_limited_after_a_burst_and_recovers() -> None:
    now = [0.0]
    limit = RateLimit(2.0, 3.0, lambda: now[0])
    assert [limit.take() for _ in range(4)] == [True, True, True, False]
    now[0] = 0.5
    assert [limit.take() for _ in range(2)] == [True, False]


def test_the_limits_are_those_that_the_monitor_itself_tells() -> None:
    values = {
        "coulomb_force_low_N": "0.09",
        "coulomb_force_high_N": "nan",
        "friction_drift_judgement": "judged",
    }
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    statuses = [
        DiagnosticStatus(name="valve_2/monitor: condition", values=[KeyValue(key="x_low", value="1")]),
        DiagnosticStatus(name="valve_1/monitor: data"),
        DiagnosticStatus(name="valve_1/monitor: condition", values=pairs),
    ]
    assert (
        repr(bounds_of(statuses, "valve_1")) == "{'coulomb_force_low_N': 0.09, 'coulomb_force_high_N': nan}"
    )
    assert bounds_of(statuses[:2], "valve_1") is None


HEALTHY = {
    "viscous_coefficient": (8.0, "N s/m"),
    "coulomb_force": (0.5, "N"),
    "spring_stiffness": (5860.0, "N/m"),
}


def estimated(second: int, **changed: float) -> Estimate:
    """Return an estimate of a healthy valve in oil of a constant temperature, with what ``changed``."""
    found = {
        name: Measured(name, unit, changed.get(name, value), 1e-3 * value, Validity.VALID)
        for name, (value, unit) in HEALTHY.items()
    }
    nothing, oil = Measured("", "1"), Measured("oil_temperature", "deg C", 40.0, 0.5, Validity.VALID)
    referred = replace(found["viscous_coefficient"], name="referred_viscous_coefficient")
    return Estimate(
        stamp=second * 10**9, model="coulomb", state=State.TRACKING, last_sequence=0, samples=0, delay=0.375,
        memory=4.0, parameters=tuple(found.values()), natural_frequency=nothing, damping_ratio=nothing,
        residual=nothing, excitation=nothing, relative_displacement=nothing, oil_temperature=oil,
        referred_viscous_coefficient=referred,
    )  # fmt: skip


@pytest.mark.parametrize("name", tuple(Monitor().detection.parameters))
@pytest.mark.parametrize(("end", "sign"), [("low", -1.0), ("high", 1.0)])
def test_the_band_of_the_page_ends_at_the_limit_that_the_event_states(
    name: str, end: str, sign: float
) -> None:
    """Estimates drift by 0.2 % a second until the monitor warns; the page gets its limits by messages."""
    monitor, second = Monitor(MonitorSettings(natural_frequency=28.7)), 0
    events: list[Event] = []
    start, unit = HEALTHY[name]
    while not events:
        second += 1
        assert second < 600
        drifted = start * (1.0 + sign * 2e-3 * max(0, second - 40))
        events = monitor.update_estimate(estimated(second, **{name: drifted}))
    facts = events[0].facts
    assert (facts.parameter, events[0].severity) == (name, MonitorSeverity.WARNING)
    status = condition_status(monitor, monitor.health)
    pairs = [
        KeyValue(key=key, value=f"{value:.6g}" if isinstance(value, float) else str(value))
        for key, value in status.values.items()
    ]
    one = valve()
    one.bounds = bounds_of([DiagnosticStatus(name="v/monitor: condition", values=pairs)], "v") or {}
    one.estimate = tracking()
    one.baseline = ManageBaseline.Response(success=True, values=[quantity(name, unit, start)])
    (shown_there,) = (one for one in detail_of(one, 100.0)["estimate"]["parameters"] if one["name"] == name)
    assert shown_there[end] == pytest.approx(facts.limit, rel=1e-5)
    assert limits_of(one, name)[end] == shown_there[end]


def test_missing_time_is_an_empty_line_and_the_last_time_before_it_is_named() -> None:
    fall = deque([(0.0, [1.0]), (0.5, [2.0]), (0.6 + BROKEN, [3.0])])
    found = waterfall_of(fall, 4.0)
    assert (found["spool"], found["until"]) == ([[1.0], [2.0], [], [3.0]], 0.0)
    assert waterfall_of(deque([(0.0, [1.0])]), 1.0) == {"step": 0.5, "spool": [[1.0]], "until": None}
