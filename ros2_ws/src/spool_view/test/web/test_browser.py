"""The page in a real Chromium on live nodes: what is shown and when, an operator's acts, accessibility."""

from __future__ import annotations

import gzip
import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.request import ProxyHandler, build_opener

import pytest
from spool_core.opcua_folder import keep_operator
from spool_msgs.msg import AlarmList

from .conftest import (
    CHROMIUM,
    FLAGS,
    PATIENCE,
    Domain,
    StandIn,
    alarm,
    good_health,
    quantity,
    tracking,
    until,
)

AXE = Path(__file__).parent / "vendor" / "axe.min.js.gz"
LIGHT = "#light .light, [data-valve=valve_1] .light"


def condition(page: Any) -> str:
    light = page.query_selector(LIGHT)
    return "" if light is None else str(light.get_attribute("data-condition"))


def becomes(page: Any, wanted: str) -> None:
    """Wait until the valve's light is ``wanted``."""
    found = ", ".join(f"{light}[data-condition={wanted}]" for light in LIGHT.split(", "))
    page.wait_for_selector(found, timeout=1000 * PATIENCE)


def test_resonance_and_drift_are_shown_on_both_pages_without_a_reload(
    domain: Domain, stand_in: Callable[..., StandIn], open_page: Callable[..., Any]
) -> None:
    monitor = stand_in()
    _, address = domain.page()
    machine, valve = open_page(address), open_page(f"{address}valve/valve_1")
    for page in (machine, valve):
        becomes(page, "good")
    monitor.health = good_health("resonance", shakes=28.0)
    monitor.health.level = 3
    monitor.alarms = AlarmList(alarms=[alarm()])
    monitor.say()
    for page in (machine, valve):
        becomes(page, "alarm")
        page.wait_for_selector("[data-alarm=resonance] [data-state=unacknowledged]")
        page.wait_for_selector("main :text('2 % below')")
    monitor.estimate = tracking()
    monitor.estimate.parameters[2] = quantity("coulomb_force", "N", 0.35, 0.005)
    monitor.say()
    valve.wait_for_selector("tr[data-parameter=coulomb_force] >> text=0.3500 ± 0.0098 N")
    assert "Read only" in machine.inner_text("header")
    assert valve.query_selector("button[data-act]") is None


@pytest.mark.parametrize(
    ("locale", "said", "limit"),
    [
        ("en-GB", "Resonance: amplification 4.2, limit 3.6", "Limit"),
        ("de-DE", "Resonanz: Verstärkung 4,2, Grenze 3,6", "Grenze"),
        ("pl-PL", "Rezonans: wzmocnienie 4,2, granica 3,6", "Granica"),
    ],
)
def test_an_alarm_shows_its_headline_and_its_details_on_demand(
    domain: Domain,
    stand_in: Callable[..., StandIn],
    open_page: Callable[..., Any],
    locale: str,
    said: str,
    limit: str,
) -> None:
    monitor = stand_in()
    monitor.alarms = AlarmList(alarms=[alarm()])
    _, address = domain.page()
    page = open_page(address, locale=locale)
    page.wait_for_selector("[data-alarm=resonance]")
    assert page.inner_text("[data-alarm=resonance] summary") == said
    assert not page.is_visible("[data-alarm=resonance] dl")
    page.click("[data-alarm=resonance] summary")
    assert limit in page.inner_text("[data-alarm=resonance] dl")
    # A new message of the same alarm leaves open what the reader opened.
    monitor.alarms.alarms[0].comment = "seen"
    monitor.say()
    page.wait_for_selector("[data-alarm=resonance] >> text=seen")
    assert page.is_visible("[data-alarm=resonance] dl")


def test_a_monitor_that_falls_silent_and_a_page_that_ends_leave_nothing_green(
    domain: Domain, stand_in: Callable[..., StandIn], open_page: Callable[..., Any]
) -> None:
    monitor = stand_in()
    process, address = domain.page()
    page = open_page(address)
    becomes(page, "good")
    monitor.close()
    becomes(page, "no_word")
    process.kill()
    page.wait_for_selector(".link.lost")
    assert page.query_selector(".light.good:not(dl *)") is None


def test_a_publisher_that_is_killed_is_stale_and_an_operator_acts_by_mouse_and_keyboard(
    domain: Domain, open_page: Callable[..., Any]
) -> None:
    """Real nodes: simulator, estimator, monitor (silence of 1.5 s is stale)."""
    own = ("-r", "__ns:=/valve_1")
    domain.start("spool_monitor", "monitor", *own, baseline_time=3.0)
    domain.start("spool_estimator", "estimator", *own)
    simulator = domain.start("spool_sim", "simulator", *own, excitation="multisine", wait_for_subscribers=2)
    _, address = domain.page(operator=True)
    page = open_page(f"{address}valve/valve_1")
    becomes(page, "good")
    page.wait_for_selector("#spectrum_text:has-text('Hz')", state="attached")
    page.wait_for_selector("tr[data-parameter=coulomb_force] svg circle")
    simulator.kill()
    page.wait_for_selector("[data-condition=stale]:not(dl *), [data-condition=alarm]:not(dl *)")
    row = "tr[data-alarm='stale/acceleration']"
    page.wait_for_selector(f"{row} [data-state=unacknowledged]")
    # By mouse; the operator signs in on the way.
    page.click(f"{row} button[data-act=acknowledge]")
    page.fill("#who", "Eva")
    page.fill("#token", "wrong")
    page.click("#dialog_do")
    page.wait_for_selector("#dialog_said >> text=the token is wrong")
    page.fill("#token", domain.token)
    page.click("#dialog_do")
    page.fill("#comment", "cable <b>was</b> pulled")
    page.click("#dialog_do")
    page.wait_for_selector(f"{row} [data-state=acknowledged]")
    assert "cable <b>was</b> pulled" in page.inner_text(row)
    # By keyboard alone.
    page.focus(f"{row} button[data-act=shelve]")
    page.keyboard.press("Enter")
    page.keyboard.press("Escape")
    assert page.query_selector("dialog[open]") is None
    page.keyboard.press("Enter")
    page.keyboard.type("")
    page.keyboard.press("Control+A")
    page.keyboard.type("5")
    page.keyboard.press("Tab")
    page.keyboard.type("until the cable is here")
    page.keyboard.press("Enter")
    page.wait_for_selector(f"{row} [data-state=shelved]")
    page.click("button[data-act=freeze_baseline]")
    page.click("#dialog_do")
    page.wait_for_selector("#baseline >> text=confirmed by Eva")
    entries = [json.loads(line) for line in domain.log.splitlines()]
    done = [(one["act"], one["who"], one["alarm"]) for one in entries if one["step"] == "done"]
    assert done == [
        ("acknowledge", "Eva", "stale/acceleration"),
        ("shelve", "Eva", "stale/acceleration"),
        ("freeze_baseline", "Eva", ""),
    ]
    assert entries[2]["minutes"] == 5.0
    assert domain.token not in domain.log


def test_a_new_alarm_sounds_once_and_an_operator_signs_in_by_name(
    domain: Domain, stand_in: Callable[..., StandIn], open_page: Callable[..., Any]
) -> None:
    keep_operator(domain.folder / "secure", "Eva", "correct horse")
    monitor = stand_in()
    _, address = domain.page(operator=True, security_folder=str(domain.folder / "secure"))
    page = open_page(f"{address}valve/valve_1")
    becomes(page, "good")
    page.click("#sound")
    monitor.alarms = AlarmList(alarms=[alarm()])
    monitor.say()
    page.wait_for_selector("#sound[data-played='1'][aria-pressed=true]")
    monitor.say()
    page.click("tr[data-alarm=resonance] button[data-act=acknowledge]")
    page.fill("#who", "Eva")
    page.fill("#token", "wrong horse")
    page.click("#dialog_do")
    page.wait_for_selector("#dialog_said >> text=name or password is wrong")
    page.fill("#token", "correct horse")
    page.click("#dialog_do")
    page.wait_for_selector("#mode >> text=Eva")
    page.wait_for_selector("#comment")
    assert page.query_selector("#dialog #who") is None
    assert page.get_attribute("#sound", "data-played") == "1"


def test_markup_in_what_others_say_stays_text(
    domain: Domain, stand_in: Callable[..., StandIn], open_page: Callable[..., Any]
) -> None:
    evil = "<img src=x onerror=\"document.title='owned'\"><script>document.title='owned'</script>\u202e"
    monitor = stand_in()
    monitor.health.summary = evil
    monitor.health.judgements = [evil]
    monitor.estimate.model = evil
    monitor.alarms = AlarmList(alarms=[alarm(name=f"x'\"><{evil}", note=evil, comment=evil)])
    _, address = domain.page(operator=True)
    for path in ("", "valve/valve_1"):
        page = open_page(f"{address}{path}")
        page.wait_for_selector("[data-alarm]")
        page.wait_for_timeout(1000)
        assert "owned" not in page.title()
        assert page.query_selector("main img, main script") is None
        assert "<img src=x" in page.inner_text("main")


@pytest.mark.parametrize(("scheme", "width"), [("light", 1280), ("dark", 390)])
def test_axe_finds_nothing_serious_and_the_page_fits(
    domain: Domain, stand_in: Callable[..., StandIn], open_page: Callable[..., Any], scheme: str, width: int
) -> None:
    monitor = stand_in()
    monitor.health.level = 2
    monitor.alarms = AlarmList(alarms=[alarm()])
    _, address = domain.page(operator=True)
    axe = gzip.decompress(AXE.read_bytes()).decode()
    for path in ("", "valve/valve_1"):
        page = open_page(f"{address}{path}", width=width, color_scheme=scheme, locale="de-DE")
        page.wait_for_selector("[data-alarm]")
        page.click("details summary")
        page.click("button[data-act=shelve]")
        page.wait_for_selector("dialog[open]")
        for _ in range(2):
            page.evaluate(axe)  # evaluated by the debugger, which the content security policy does not bind
            found = page.evaluate("axe.run(document, { resultTypes: ['violations'] })")
            serious = [
                (one["id"], [node["html"][:200] for node in one["nodes"]][:3])
                for one in found["violations"]
                if one["impact"] in ("serious", "critical")
            ]
            assert serious == []
            page.keyboard.press("Escape")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.get_attribute("html", "lang") == "de"
        assert "Alarme" in page.inner_text("main")


def test_language_and_focus_follow_the_keyboard(
    domain: Domain, stand_in: Callable[..., StandIn], open_page: Callable[..., Any]
) -> None:
    stand_in()
    _, address = domain.page()
    page = open_page(address, locale="en-GB")
    becomes(page, "good")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "main"
    page.click("text=Deutsch")
    page.wait_for_selector("html[lang=de] >> text=Verlauf")
    becomes(page, "good")
    assert "Gut" in page.inner_text("[data-valve=valve_1]")
    assert page.get_attribute("#announcer", "aria-live") == "assertive"


def test_no_request_leaves_this_host(
    domain: Domain, stand_in: Callable[..., StandIn], tmp_path: Path, chromium: Any
) -> None:
    """By the browser's own log of its network, not by what the page tells."""
    stand_in()
    _, address = domain.page()
    log = tmp_path / "net.json"
    # The browser looks up its maker's names; here it finds none, so all that is sent is the page's.
    rules = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
    flags = [*FLAGS, rules, f"--log-net-log={log}", "--net-log-capture-mode=Everything"]
    browser = chromium.browser_type.launch(executable_path=CHROMIUM, args=flags)
    page = browser.new_page()
    for path in ("", "valve/valve_1"):
        page.goto(f"{address}{path}")
        becomes(page, "good")
    page.wait_for_timeout(3000)
    browser.close()
    text = log.read_text(errors="replace", encoding="utf-8").rstrip()
    found = json.loads(text if text.endswith("}") else text.rstrip(",") + "]}")
    names = {number: name for name, number in found["constants"]["logEventTypes"].items()}
    events = [(names[one["type"]], one.get("params", {})) for one in found["events"]]
    asked = [
        given["url"]
        for name, given in events
        # The end of a request has no address; the browser asks for its maker's by itself.
        if name == "URL_REQUEST_START_JOB" and "url" in given and "google" not in given["url"]
    ]
    assert len(asked) > 15
    assert [url for url in asked if not url.startswith(address)] == []
    attempts = {
        given["address"] for name, given in events if name == "TCP_CONNECT_ATTEMPT" and "address" in given
    }
    assert attempts == {address.removeprefix("http://").rstrip("/")}
    assert [given for name, given in events if name == "UDP_BYTES_SENT"] == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_page_ends_with_streams_open(
    domain: Domain, stand_in: Callable[..., StandIn], number: int
) -> None:
    stand_in()
    process, address = domain.page(operator=True)
    reader = build_opener(ProxyHandler({}))
    streams = [reader.open(f"{address}stream/machine", timeout=PATIENCE) for _ in range(10)]
    until(lambda: all(one.readline() for one in streams), "the streams have begun")
    process.send_signal(number)
    assert process.wait(timeout=PATIENCE) == 0
    assert not list((domain.folder / "state" / "spool" / "web_page").glob("token_*"))
