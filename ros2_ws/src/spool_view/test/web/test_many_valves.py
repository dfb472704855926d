"""A hundred valves in a real browser: the machine on one screen, the list of alarms, the history; no ROS."""

from __future__ import annotations

import io
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image
from spool_core.events.event import Event, EventState, Facts, Severity, Urgency
from spool_core.events.language import LANGUAGES
from spool_core.node.messages import to_event_message
from spool_core.uncertainty import Quantity as Measured
from spool_monitor.journal import Journal, JournalEntry
from spool_monitor.listener import HeardValve
from spool_monitor.state_database import FILE
from spool_monitor.state_file import valve_folder
from spool_monitor.trend import Sums, TrendStore
from spool_msgs.msg import Alarm, AlarmList, ValveHealth
from spool_msgs.srv import ManageBaseline
from spool_view.application import ServerThread

from .conftest import Station, good_health, quantity, tracking, until

VALVES = tuple(f"press_{number // 10 + 1}/valve_{number % 10 + 1}" for number in range(100))
NOW = int(time.time())
COLOURED = 24  # difference of the channels of a pixel, of 255, from which it is no grey


def alarm_of(code: int, kind: str, cause: str = "", *, raised: int = NOW, parameter: str = "") -> Alarm:
    """Return an alarm that waits, as a monitor publishes it."""
    judged = Measured(parameter or "amplification", "1", 4.2, 0.1)
    facts = replace(Facts.of(judged, 3.6), urgency=Urgency.SOON, advice=code)
    event = Event(
        raised * 10**9, kind, EventState.RAISED, Severity.ALARM, cause, judged, parameter, code, facts
    )
    found = Alarm(
        name=f"{kind}/{parameter}" if parameter else kind, kind=kind, cause=cause, code=code, severity=2,
        state=Alarm.STATE_UNACKNOWLEDGED, occurrence=1, namur=ValveHealth.NAMUR_OUT_OF_SPECIFICATION,
    )  # fmt: skip
    found.event = to_event_message(event, "valve", LANGUAGES["en"])
    found.message, found.raised_at.sec = found.event.message, raised
    return found


@pytest.fixture(name="machine")
def _machine(make_station: Callable[..., Station]) -> Iterator[tuple[Station, str]]:
    """A machine of healthy valves, heard each second, and the address of its page."""
    spectra = {"step": 0.5, "body": [0.1] * 400, "spool": [3.0] * 400}
    station = make_station(spectrum=lambda _: dict(spectra))
    valves = station.desk.valves
    valves.clear()
    for name in VALVES:
        valve = HeardValve(name, good_health(), time.monotonic(), tracking(), AlarmList())
        valve.limits = {"resonance_band": 0.1}
        valves[name] = valve
    own = socket.create_server(("127.0.0.1", 0))
    server = ServerThread(station.application, own)
    server.start()
    ended = threading.Event()

    def speak() -> None:
        count = 0
        while not ended.wait(0.2):
            count += 1
            for valve in valves.values():
                valve.health_at = time.monotonic()
                valve.changes += 1
                valve.blocks.append(str(count).encode())

    speaker = threading.Thread(target=speak)
    speaker.start()
    yield station, f"http://127.0.0.1:{own.getsockname()[1]}/"
    ended.set()
    speaker.join()
    server.stop()
    own.close()


def test_a_hundred_healthy_valves_fit_a_screen_and_show_no_colour(
    machine: tuple[Station, str], open_page: Callable[..., Any]
) -> None:
    _, address = machine
    page = open_page(address, width=1280, height=900)
    until(lambda: len(page.query_selector_all("#valves .tile")) == 100, "a tile for each valve")
    assert page.inner_text("#sentence") == "No valve needs attention; 100 are watched."
    bottom = page.evaluate(
        "Math.max(...[...document.querySelectorAll('.tile')].map(one => one.getBoundingClientRect().bottom))"
    )
    assert bottom <= 900
    pixels = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB")).astype(int)
    coloured = (pixels.max(axis=2) - pixels.min(axis=2)) > COLOURED
    assert coloured.mean() < 0.005


def test_one_abnormal_valve_comes_first_and_the_sentence_says_what_to_do(
    machine: tuple[Station, str], open_page: Callable[..., Any]
) -> None:
    station, address = machine
    valve = station.desk.valves["press_5/valve_7"]
    contaminated = alarm_of(202, "friction_drift", "oil_contamination", parameter="coulomb_force")
    assert valve.health is not None
    valve.health.level, valve.health.namur = ValveHealth.LEVEL_ALARM, ValveHealth.NAMUR_MAINTENANCE_REQUIRED
    contaminated.namur = ValveHealth.NAMUR_MAINTENANCE_REQUIRED
    over = alarm_of(801, "stale", raised=NOW + 1)
    over.state = Alarm.STATE_RETURNED_UNACKNOWLEDGED
    valve.alarms = AlarmList(alarms=[over, contaminated])
    page = open_page(address, width=1280, height=900)
    page.wait_for_selector(
        "#worst .tile:first-child[data-valve='press_5/valve_7'] .light.alarm[data-letter=M]"
    )
    sentence = page.inner_text("#sentence")
    assert sentence.startswith("Soon: Friction drift (oil contamination) in press_5/valve_7, for ")
    assert "Take an oil sample" in sentence
    assert "others" not in sentence
    assert page.inner_text("#banner") == "2 to acknowledge"
    assert page.inner_text("#worst .tile:first-child .news").startswith(
        "Friction drift (oil contamination), "
    )
    page.goto(f"{address}valve/press_5/valve_7")
    page.wait_for_selector("#headline strong >> text=Friction drift (oil contamination)")
    assert "null" not in page.inner_text("#headline")


def test_an_act_of_maintenance_is_one_row_that_says_who_and_until_when(
    machine: tuple[Station, str], open_page: Callable[..., Any]
) -> None:
    station, address = machine
    valve = station.desk.valves["press_2/valve_3"]
    kinds = [(301, "spring_change", "softer"), (100, "resonance", ""), (201, "friction_drift", "wear")]
    valve.alarms = AlarmList(alarms=[alarm_of(*kind) for kind in kinds])
    for one in valve.alarms.alarms:
        one.state, one.hidden_by, one.hidden_comment = Alarm.STATE_OUT_OF_SERVICE, "Jan", "new seal"
        one.hidden_at.sec, one.shelved_until.sec = NOW, NOW + 3600
    page = open_page(address, width=1280, height=900)
    page.wait_for_selector(".tile[data-valve='press_2/valve_3'] .light.put_aside")
    assert len(page.query_selector_all("#alarms tbody tr")) == 1
    row = page.inner_text("#alarms tbody tr")
    assert "press_2/valve_3: 3 alarms out of service" in row
    assert "Jan" in row
    assert "new seal" in row
    assert page.inner_text("#sentence").startswith("No valve needs attention")


def test_forty_of_312_alarms_are_acknowledged_once_with_one_comment(
    machine: tuple[Station, str], open_page: Callable[..., Any]
) -> None:
    station, address = machine
    kinds = [(301, "spring_change", "softer"), (100, "resonance", ""), (500, "model_gap", "")]
    more = (201, "friction_drift", "wear")
    for number, valve in enumerate(station.desk.valves.values()):
        own = [*kinds, more] if number < 12 else kinds
        valve.alarms = AlarmList(alarms=[alarm_of(*kind, raised=NOW - 100 * number) for kind in own])
    page = open_page(f"{address}alarms#token={station.token}", width=1280, height=900)
    page.wait_for_selector("text=200 of 312 shown")
    page.fill("#alarms_words", "resonance press_")
    page.wait_for_selector("text=100 of 312 shown")
    page.select_option("#alarms_sort", "valve")
    page.wait_for_selector("[data-alarm=resonance]")
    boxes = page.query_selector_all("tr[data-alarm=resonance] input[type=checkbox]")
    names = [box.get_attribute("data-key") for box in boxes[:40]]
    for name in names:
        page.check(f"[data-key='{name}']")
    page.wait_for_selector("text=40 selected")
    page.click("[data-many=acknowledge]")
    page.fill("#comment", "speed reduced")
    page.fill("#who", "Eva")
    page.click("#dialog_do")
    page.wait_for_selector("text=40 of 40")
    wanted = {f"select {act.valve} {act.alarm} 1" for act in station.asked}
    assert wanted == set(names)
    assert {(act.act, act.who, act.comment, act.occurrence) for act in station.asked} == {
        ("acknowledge", "Eva", "speed reduced", 1)
    }
    assert len(station.asked) == 40
    assert station.log.count('"step": "asked"') == 40


def test_a_common_cause_is_one_entry_and_a_valves_own_fault_stays_its_own(
    machine: tuple[Station, str], open_page: Callable[..., Any]
) -> None:
    station, address = machine
    for number, valve in enumerate(station.desk.valves.values()):
        valve.alarms = AlarmList(alarms=[alarm_of(707, "data_fault", "clock_step", raised=NOW + number // 4)])
    stuck = station.desk.valves["press_3/valve_3"]
    stuck.alarms = AlarmList(alarms=[*stuck.alarms.alarms, alarm_of(400, "stuck_spool")])
    page = open_page(f"{address}alarms", width=1280, height=900)
    page.wait_for_selector("tr[data-group='707']")
    page.wait_for_selector("#banner >> text=2 to acknowledge")
    assert page.inner_text("tr[data-group='707'] button") == "▸ 100 valves: Clock step"
    assert len(page.query_selector_all("tr[data-alarm]")) == 1
    page.click("tr[data-group='707'] button")
    until(lambda: len(page.query_selector_all("tr[data-alarm=data_fault]")) == 100, "the valves beneath")


def keep_trends(station: Station, valve: str, minutes: int, **units: str) -> None:
    """Keep the last minutes of a valve's parameters: 0.1 each."""
    path = valve_folder(station.desk.state_folder, valve) / FILE
    path.parent.mkdir(parents=True)
    store, sums = TrendStore(path), Sums()
    for minute in range(minutes):
        for parameter, unit in units.items():
            sums.add((NOW - 60 * minute) * 10**9, parameter, unit, 0.1)
    store.write(sums)
    store.close()


def test_after_a_reload_waterfall_and_trend_are_there(
    machine: tuple[Station, str], open_page: Callable[..., Any]
) -> None:
    station, address = machine
    name = VALVES[0]
    keep_trends(station, name, 50, coulomb_force="N")
    page = open_page(f"{address}valve/{name}", width=1280, height=900)
    lit = """() => { const c = document.getElementById("waterfall");
        const d = c.getContext("2d").getImageData(0, 0, c.width, 120).data;
        let rows = 0; for (let y = 0; y < 120; y++) rows += d[4 * y * c.width + 2] > 100; return rows; }"""
    until(lambda: page.evaluate(lit) >= 8, "spectra are drawn")
    before = page.evaluate(lit)
    page.reload()
    page.wait_for_selector("#spectrum canvas")
    assert page.evaluate(lit) >= before
    page.wait_for_selector("text=Coulomb force: 0.1000 to 0.1000 N")
    page.wait_for_selector("#trend canvas")


def test_the_trend_is_of_the_alarms_parameter_also_where_an_earlier_answer_is_late(
    machine: tuple[Station, str], open_page: Callable[..., Any]
) -> None:
    station, address = machine
    name = VALVES[0]
    keep_trends(station, name, 5, natural_frequency="Hz", coulomb_force="N")
    one = station.desk.valves[name]
    one.alarms = AlarmList(alarms=[alarm_of(202, "friction_drift", parameter="coulomb_force")])
    one.baseline = ManageBaseline.Response(success=True, values=[quantity("coulomb_force", "N", 0.1)])
    page = open_page("about:blank")
    late: list[Any] = []
    page.route("**/trend?*", lambda route: route.continue_() if late else late.append(route))
    page.goto(f"{address}valve/{name}")
    page.wait_for_selector("#trend_text >> text=Coulomb force: 0.1000")
    with page.expect_event("requestfinished", lambda request: request == late[0].request):
        late[0].continue_()
    page.wait_for_function("new Promise(done => setTimeout(() => done(true)))")  # the answer was taken
    assert page.inner_text("#trend_text").startswith("Coulomb force")
    assert page.input_value("#trend_parameter") == "coulomb_force"


def test_the_history_is_searched_counted_and_printed(
    machine: tuple[Station, str], open_page: Callable[..., Any]
) -> None:
    station, address = machine
    path = valve_folder(station.desk.state_folder, VALVES[0]) / FILE
    path.parent.mkdir(parents=True)
    journal, stamp = Journal(path), (NOW - 3600) * 10**9
    raised = JournalEntry(
        stamp, "raise", "resonance", 100, "S", "alarm", "unacknowledged", 1, text="Resonance"
    )
    seen = replace(raised, stamp=stamp + 10**9, action="acknowledge", state="acknowledged", who="Eva")
    journal.write([raised, seen])
    journal.close()
    page = open_page(f"{address}history", width=1280, height=900)
    page.wait_for_selector("text=2 of 2 shown")
    assert "most alarms in 10 min 1 10" in " ".join(page.inner_text("#figures").split())
    page.fill("#words", "eva resonance")
    page.wait_for_selector("text=1 of 1 shown")
    table = station.client.get("/history.csv?range=all&search=eva").text.splitlines()
    assert len(table) == 2
    assert table[1].startswith(f"{time.strftime('%Y-%m-%dT', time.gmtime(NOW - 3599))}")
    page.emulate_media(media="print")
    until(lambda: not page.is_visible("header"), "the print view has no controls")
    assert page.is_visible("#entries table")
    page.emulate_media(media="screen")
    page.click("text=Deutsch")
    page.wait_for_selector("text=quittiert")
