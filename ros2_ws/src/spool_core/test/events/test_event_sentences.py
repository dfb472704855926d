"""Sentences of events: short, complete, and the same facts in every language."""

from __future__ import annotations

import math
import re
from dataclasses import fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_core.events.event import Event, EventState, Facts, Namur, Severity, Urgency, urgency_of
from spool_core.events.language import ENGLISH, LANGUAGES, Language
from spool_core.events.sentences import COUNTS, VARIABLE, described, details, duration, headline, language_of
from spool_core.uncertainty import Quantity, Validity

SECOND = 1_000_000_000
STAMP = 1_700_000_000 * SECOND
RAISED, CLEARED = EventState.RAISED, EventState.CLEARED
JUDGED = Quantity("coulomb_force_change", "N", 0.25, 0.007, Validity.VALID)
CODES = sorted(ENGLISH.events)
every_language = pytest.mark.parametrize("language", LANGUAGES.values(), ids=LANGUAGES)

#: An event with every field.
FACTS = Facts(
    parameter="coulomb_force",
    unit="N",
    value=0.350,
    low=0.339,
    high=0.361,
    baseline=0.100,
    change=0.250,
    limit=0.200,
    began=STAMP - 6 * SECOND,
    causes=("oil_contamination", "wear"),
    probabilities=(0.87, 0.13),
    false_alarm_interval=3.6e6,
    urgency=Urgency.SOON,
    time_to_limit=2040.0,
    advice=202,
    subject="spool",
    note="oil_referred",
    evidence=(Quantity("viscous_coefficient_change", "1", -0.04, 0.01, Validity.VALID),),
)


def event(facts: Facts = FACTS, code: int = 202, state: EventState = RAISED, text: str = "") -> Event:
    kind = "friction_drift"
    return Event(STAMP, kind, state, Severity.WARNING, "oil_contamination", JUDGED, "", code, facts, text)


def test_an_event_reads_as_people_need_it() -> None:
    assert described(event(replace(FACTS, subject=""))).splitlines() == [
        "Friction drift (oil contamination): Coulomb force 0.350 N, limit 0.200 N",
        "  Measured: Coulomb force 0.350 N (0.339 N to 0.361 N, 95 %)",
        "  Healthy valve: 0.100 N",
        "  Change: +0.250 N (+250 %)",
        "  Limit: 0.200 N",
        "  Began: 6.0 s before this message",
        "  Possible causes: oil contamination 87 %, wear 13 %",
        "  Further numbers: change of the viscous coefficient -4.0 ± 2.0 %",
        "  Remark: compared at the same oil temperature",
        "  Expected false-alarm interval: 42 days",
        "  Urgency: soon",
        "  Time to the alarm limit: 34 min",
        "  Meaning: Particles or varnish rub in the gap; dry friction rises and the spool begins to stick.",
        "  What to do: take an oil sample (ISO 4406), change the filter, flush, clean the spool (number 202)",
    ]


@given(
    language=st.sampled_from(list(LANGUAGES.values())),
    code=st.sampled_from(CODES),
    state=st.sampled_from([RAISED, CLEARED]),
    parameter=st.sampled_from(sorted(ENGLISH.parameters)),
    unit=st.sampled_from(["1", "N", "N s/m", "m/s^2", "deg C", "s", "m"]),
    value=st.floats(-1e9, 1e9) | st.just(math.nan),
    limit=st.floats(-1e9, 1e9),
    half=st.floats(1e-6, 1e3) | st.just(math.nan),
    subject=st.sampled_from(["", "body", "spool", "both", "valve_2", "a name of five words"]),
)
def test_a_headline_has_twelve_words_at_most_and_names_the_limit_of_what_is_known(
    language: Language,
    code: int,
    state: EventState,
    parameter: str,
    unit: str,
    value: float,
    limit: float,
    half: float,
    subject: str,
) -> None:
    # A title that names its cause belongs to a parameter of the valve: it has no channel to name.
    caused = "(" in language.event(code).title
    if caused:
        parameter, subject = "viscous_coefficient", ""
    elif len(language.parameter(parameter).split()) > 3:  # evidence, never judged
        parameter = "amplification"
    if code // 100 == 8:  # of silence only
        parameter = "silence"
    facts = Facts(parameter, unit, value, value - half, value + half, limit=limit, subject=subject)
    said = headline(event(facts, code, state), language)
    assert len(said.split()) <= 12, said
    assert said.startswith(language.event(code).title)
    limited = math.isfinite(value) and parameter not in COUNTS
    assert bool(re.search(r"(limit|Grenze|granica) -?[0-9]", said)) is limited
    assert "\n" not in said


@pytest.mark.parametrize(
    ("facts", "code", "state", "said"),
    [
        (Facts("faulty_blocks", "1", 24.0, limit=0.0), 703, RAISED, "Lost blocks: 24"),
        (Facts("silence", "s", limit=1.5), 801, CLEARED, "No acceleration ended"),
        (Facts(subject="4weh10_stiff"), 702, RAISED, "Second source (4weh10_stiff)"),
        (Facts("silence", "s", 3.7, limit=1.5), 801, RAISED, "No acceleration: silence 3.7 s, limit 1.5 s"),
    ],
)
def test_a_headline_names_no_limit_of_a_count_and_nothing_that_is_unknown(
    facts: Facts, code: int, state: EventState, said: str
) -> None:
    assert headline(event(facts, code, state)) == said


@every_language
@pytest.mark.parametrize("name", [one.name for one in fields(Facts)])
def test_no_field_is_lost(language: Language, name: str) -> None:
    without = {one.name: one.default for one in fields(Facts)}[name]
    # The unit shows with a number, a probability with its cause.
    assert described(event(), language) != described(event(replace(FACTS, **{name: without})), language)


@every_language
def test_details_name_the_numbers_of_their_fields(language: Language) -> None:
    shown = {one.field: one.text.replace(",", ".") for one in details(event(), language)}
    for field, number in {
        "measured": "0.350 N", "baseline": "0.100 N", "change": "+0.250 N", "limit": "0.200 N",
        "causes": "87 %", "evidence": "-4.0 ± 2.0 %", "false_alarm_interval": "42", "time_to_limit": "34",
        "advice": "202", "began": "6.0",
    }.items():  # fmt: skip
        assert number in shown[field], field


@every_language
def test_every_language_has_every_text(language: Language) -> None:
    codes = {key for key in language.words if " " not in key}
    assert codes == {key for key in ENGLISH.words if " " not in key}
    assert set(language.words) - codes == set(LANGUAGES["de"].words if language.code != "en" else ()) - codes
    assert set(language.parameters) == set(ENGLISH.parameters)
    assert set(language.labels) == set(ENGLISH.labels)
    assert set(language.events) == set(ENGLISH.events)
    titles = [language.event(code).title for code in CODES]
    assert len(set(titles)) == len(titles)
    for code, texts in language.events.items():
        own = ENGLISH.events[code]
        assert [bool(text) for text in texts] == [bool(text) for text in own], code


def test_what_is_over_lasted_since_it_was_raised_and_advises_nothing() -> None:
    over = replace(FACTS, advice=0, urgency=Urgency.NONE, causes=(), probabilities=(), subject="")
    found = event(over, state=CLEARED)
    assert headline(found) == (
        "Friction drift (oil contamination) ended: Coulomb force 0.350 N, limit 0.200 N"
    )
    shown = {one.field: one.text for one in details(found)}
    assert shown["lasted"] == "6.0 s"
    assert not shown.keys() & {"advice", "urgency", "time_to_limit", "began"}


def test_an_event_of_an_earlier_version_keeps_its_sentence() -> None:
    sentence = "Coulomb force rose by 0.250 N; began about 6.0 s ago; what to do: take an oil sample"
    old = event(Facts(), code=0, text=sentence)
    assert headline(old, LANGUAGES["de"]) == "Coulomb force rose by 0.250 N"
    assert sentence in described(old)


def test_a_clock_that_was_set_back_makes_no_time_negative() -> None:
    ahead = event(replace(FACTS, began=STAMP + SECOND))
    assert "began" not in {one.field for one in details(ahead)}


def test_a_kind_without_texts_is_named_by_its_own_name() -> None:
    hot = Event(
        STAMP, "hot_oil", RAISED, Severity.WARNING, "", JUDGED, code=1000,
        facts=Facts("oil_temperature", "deg C", 90.0, limit=80.0, advice=1000),
    )  # fmt: skip
    assert headline(hot) == "Hot oil: oil temperature 90 °C, limit 80 °C"


def test_orders_are_counted_as_people_say_them() -> None:
    said = {}
    for order in (1.0, 2.0, 3.0, 4.0, 11.0, 12.0, 13.0, 21.0, 22.0, 23.0, 30.0, 101.0, 111.0, 112.0, 2.5):
        numbers = (Quantity("order", "1", order), Quantity("speed", "rev/min", 857.0))
        found = re.search(
            r"\((\S+) order of the pump", headline(event(Facts(subject="pump", evidence=numbers)))
        )
        said[order] = "" if found is None else found[1]
    assert (
        " ".join(said.values()) == "1st 2nd 3rd 4th 11th 12th 13th 21st 22nd 23rd 30th 101st 111th 112th 2.5"
    )


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(7.24, "7.2 s"), (119.0, "119.0 s"), (2040.0, "34 min"), (43200.0, "12 h"), (5.0 * 86400.0, "5 days")],
)
def test_durations_are_as_people_read_them(seconds: float, text: str) -> None:
    assert duration(seconds) == text


@pytest.mark.parametrize(
    ("namur", "severity", "hurries", "urgency"),
    [
        (Namur.FAILURE, Severity.WARNING, False, Urgency.IMMEDIATE),
        (Namur.OUT_OF_SPECIFICATION, Severity.ALARM, False, Urgency.IMMEDIATE),
        (Namur.OUT_OF_SPECIFICATION, Severity.WARNING, False, Urgency.SOON),
        (Namur.MAINTENANCE_REQUIRED, Severity.ALARM, False, Urgency.SOON),
        (Namur.MAINTENANCE_REQUIRED, Severity.WARNING, True, Urgency.SOON),
        (Namur.MAINTENANCE_REQUIRED, Severity.WARNING, False, Urgency.PLANNED),
        (Namur.NORMAL, Severity.WARNING, False, Urgency.NONE),
    ],
)
def test_urgency_follows_from_consequence_and_time(
    namur: Namur, severity: Severity, hurries: bool, urgency: Urgency
) -> None:
    assert urgency_of(namur, severity, hurries=hurries) is urgency


def test_the_language_is_that_given_then_that_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    assert language_of() is ENGLISH
    monkeypatch.setenv(VARIABLE, "pl")
    assert language_of().code == "pl"
    assert language_of("de").code == "de"
    monkeypatch.setenv(VARIABLE, "xx")
    with pytest.raises(InputError, match="SPOOL_LANGUAGE: 'xx' is not one of de, en, pl"):
        language_of()
