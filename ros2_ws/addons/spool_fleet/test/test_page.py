"""Page of the fleet in a real Chromium: lights, what changed, drill-down, no network, accessibility."""

from __future__ import annotations

import gzip
import json
import math
import re
import shlex
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spool_fleet.content import PageContent, page_content, write_reports
from spool_fleet.fleet_page import fleet_page
from spool_fleet.judgement import write_trends
from spool_fleet.manifest import Entry, Manifest, Outcome, Service
from spool_fleet.parquet import bring_up_to_date

AXE = Path(__file__).parents[3] / "src" / "spool_view" / "test" / "web" / "vendor" / "axe.min.js.gz"
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
#: Nothing that the browser asks for by itself may be found.
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--host-resolver-rules=MAP * ~NOTFOUND"]
#: s since 1970 of Monday 2026-01-05; weeks of the fleet, days of a month.
BEGIN, WEEKS, MONTH = 1_767_571_200, 40, 30.44
EVIL = "<script>document.title='owned'</script>"
EVIL_BAG = "/data/$(touch owned) 'x' <img src=x onerror=\"document.title='owned'\">"


class Fabricated:
    """Fabricated store: bags that were never recorded, with what an analysis would have found in them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.manifest = Manifest(folder, make=True)
        self.number = 0
        self._random = np.random.default_rng(0)

    def bag(
        self,
        machine: str,
        valve: str,
        week: int,
        *,
        drag: float = 1.0,
        rubs: float = 1.0,
        celsius: float = 45.0,
        path: str = "",
        status: str = "ok",
        events: int = 0,
    ) -> str:
        """Put a bag of a week in; ``drag`` and ``rubs`` scale viscous coefficient and Coulomb force."""
        self.number += 1
        path = path or f"/data/{self.number:05d}"
        start = (BEGIN + 7 * 86_400 * week + 3600 * (self.number % 100)) * 1_000_000_000
        reason = "" if status == "ok" else "its head is damaged"
        entry = Entry(
            path, "valve_1", f"{self.number:064x}", "s", machine, valve, start, 60.0, 2000.0, 0, celsius,
            status, reason,
        )  # fmt: skip
        self.manifest.put(path, [entry])
        if status == "ok":
            noise = np.exp(self._random.normal(0.0, 0.004, 3))
            names = (
                ("viscous_coefficient_at_40C", 2.5 * drag, 0.005, "N s/m"),
                ("coulomb_force", 0.5 * rubs, 0.002, "N"),
                ("spring_stiffness", 1632.0, 0.5, "N/m"),
            )
            rows: list[list[Any]] = [
                ["monitor", "coulomb", name, value * factor, std, unit]
                for (name, value, std, unit), factor in zip(names, noise, strict=True)
            ]
            raised = [
                12.3,
                "resonance",
                "raised",
                "warning",
                None,
                4.2,
                "1",
                f"shakes at 15.2 Hz, amplified 4.2 times {EVIL}",
            ]
            found = {"parameters": rows, "events": [raised] * events}
            self.manifest.keep(path, {"monitor": "k"}, [Outcome("valve_1", "monitor", "ok", "", found)])
        return path

    def valve(self, machine: str, valve: str, weeks: range = range(WEEKS), **rates: float) -> None:
        """Put a bag of each week in; ``wears`` is the share of drag lost a month from ``since`` on."""
        since = rates.get("since", 0.0)
        for week in weeks:
            months = max(0.0, week - since) * 7.0 / MONTH
            drag = math.exp(-rates.get("wears", 0.0) * months)
            drag *= 1.0 + (rates.get("step", 0.0) if week >= since else 0.0)
            rubs = 1.0 + (rates.get("rubs", 0.0) if week >= since else 0.0)
            self.bag(machine, valve, week, drag=drag, rubs=rubs)

    def written(self) -> PageContent:
        """Write the tables, and read from them what the page shows."""
        bring_up_to_date(self.manifest)
        write_trends(self.folder, self.manifest.services())
        self.manifest.close()
        return page_content(self.folder)


def make_fleet(store: Fabricated) -> None:
    """Put in a fleet with a valve for every light."""
    for machine in ("press_1", "press_2", "press_3", "press_10"):
        for valve in ("valve_1", "valve_2", "valve_3", "valve_4"):
            if (machine, valve) not in (
                ("press_1", "valve_2"),
                ("press_1", "valve_3"),
                ("press_3", "valve_3"),
            ):
                store.valve(machine, valve, step=0.1 if machine == "press_2" else 0.0, since=24.0)
    store.valve("press_1", "valve_2", wears=0.05, since=14.0)
    store.valve("press_1", "valve_3", step=-0.08, since=36.0)
    store.valve("press_3", "valve_3", range(35))
    store.valve(EVIL, "valve_1", range(37, 40))
    store.bag(EVIL, "valve_1", WEEKS - 1, path=EVIL_BAG, events=2)
    store.bag("press_3", "valve_5", 12, status="damaged")
    store.manifest.add_service(
        Service("press_10", "", (BEGIN + 100 * 86_400) * 1_000_000_000, "oil_change", f"new drum {EVIL}")
    )


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> PageContent:
    store = Fabricated(tmp_path_factory.mktemp("fleet") / "store")
    make_fleet(store)
    return store.written()


@pytest.fixture(scope="module")
def page_file(content: PageContent, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("page") / "fleet.html"
    file.write_text(fleet_page(content, {}), "utf-8")
    return file


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    with playwright.sync_playwright() as one:
        browser = one.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def open_page(chromium: Any) -> Iterator[Callable[..., Any]]:
    """Return what opens a file; a page that throws, logs an error or asks for more fails the test."""
    contexts: list[Any] = []
    wrong: list[str] = []
    asked: set[str] = set()
    files: set[str] = set()

    def make(file: Path, fragment: str = "", *, width: int = 1280, watch: str = "", **options: Any) -> Any:
        context = chromium.new_context(viewport={"width": width, "height": 900}, **options)
        context.add_init_script(watch)
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
        page.on("request", lambda request: asked.add(request.url.partition("#")[0]))
        files.add(file.as_uri())
        page.goto(file.as_uri() + fragment)
        return page

    yield make
    for context in contexts:
        context.close()
    assert wrong == []
    assert asked == files


def lights(content: PageContent) -> dict[str, str]:
    return {valve.name: valve.light.name for valve in content.valves}


def test_every_valve_has_its_light(content: PageContent) -> None:
    found = lights(content)
    assert found.pop("press_1 valve_2") == "alarm"
    assert found.pop("press_1 valve_3") == "warning"
    assert found.pop("press_3 valve_3") == "silent"
    assert found.pop("press_3 valve_5") == "unknown"
    assert found.pop(f"{EVIL} valve_1") == "learning"
    assert {found.pop(f"press_2 valve_{number}") for number in range(1, 5)} == {"whole"}
    assert set(found.values()) == {"good"}
    assert content.summary == (
        "18 valves: 2 changed, 4 with their whole machine, 1 silent, 1 learning, 1 unknown"
    )


def test_machines_and_valves_stand_in_the_order_of_their_numbers(content: PageContent) -> None:
    assert list(content.machines)[-4:] == ["press_1", "press_2", "press_3", "press_10"]


def test_the_page_shows_each_light_with_mark_word_and_colour(
    page_file: Path, content: PageContent, open_page: Callable[..., Any]
) -> None:
    page = open_page(page_file)
    cells = page.query_selector_all(".cells a")
    assert len(cells) == len(content.valves)
    words = {cell.get_attribute("data-light"): cell.inner_text() for cell in cells}
    assert {name: text.split()[0] for name, text in words.items()} == {
        "alarm": "▲", "warning": "◆", "silent": "∅", "whole": "■", "unknown": "?", "learning": "…",
        "good": "●",
    }  # fmt: skip
    assert "act now" in words["alarm"]
    colours = {
        one.evaluate("node => getComputedStyle(node).backgroundColor + getComputedStyle(node).borderStyle")
        for one in page.query_selector_all(".cells .light")
    }
    assert len(colours) == 7


def test_what_changed_this_month_is_told_apart_from_what_stands(
    page_file: Path, open_page: Callable[..., Any]
) -> None:
    page = open_page(page_file)
    new = page.inner_text(".news")
    assert "press_1 valve_3: Viscous coefficient fell by" in new
    older = page.inner_text(".older")
    assert "press_1 valve_2: Viscous coefficient fell by" in older
    assert "press_1 valve_2" not in new
    assert "press_3 valve_3 fell silent" in page.inner_text("section[aria-labelledby=month]")
    assert "Points to wear" in older
    assert "What to do: measure the internal leakage" in older
    assert "past the limit of the running valve's monitor (20 %)" in older
    assert "press_2 (valve_1, valve_2, valve_3, valve_4): Viscous coefficient rose by" in older
    first = page.inner_text("section[aria-labelledby=worst] tbody tr")
    assert "press_1 valve_2" in first


def test_a_valve_is_reached_and_closed_by_keyboard_alone(
    page_file: Path, content: PageContent, open_page: Callable[..., Any]
) -> None:
    page = open_page(page_file)
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    (anchor,) = [valve.anchor for valve in content.valves if valve.name == "press_1 valve_2"]
    for _ in range(100):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.hash") == f"#{anchor}":
            break
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    page.keyboard.press("Enter")
    page.wait_for_selector(f"details[open] #{anchor} .large canvas")
    assert "press_1 valve_2" in page.evaluate("document.activeElement.innerText")
    inside = page.inner_text(f"#{anchor}")
    assert "Viscous coefficient fell by" in inside
    assert "./spool replay /data/" in inside
    page.keyboard.press("Enter")
    page.wait_for_selector(f"details:not([open]) #{anchor}", state="attached")


def test_a_link_opens_a_valve_without_programs(
    page_file: Path, content: PageContent, open_page: Callable[..., Any]
) -> None:
    anchor = content.valves[3].anchor
    page = open_page(page_file, f"#{anchor}", java_script_enabled=False)
    page.wait_for_selector(f"details[open] #{anchor}")


def test_charts_say_what_they_show_and_share_their_scales(
    page_file: Path, content: PageContent, open_page: Callable[..., Any]
) -> None:
    (worn,) = [valve for valve in content.valves if valve.name == "press_1 valve_2"]
    page = open_page(page_file, f"#{worn.anchor}")
    page.wait_for_selector(f"#{worn.anchor} .large canvas")
    said = page.get_attribute(f"#{worn.anchor} .large", "aria-label")
    assert said.startswith("viscous coefficient at 40 °C: baseline 2.5")
    assert "fell by" in said
    used = {one.get_attribute("data-scale") for one in page.query_selector_all(".large")}
    assert used == {"viscous_coefficient", "coulomb_force", "spring_stiffness", "temperature"}
    assert {"course", "healthy", "text", "fit"} <= colours_in(page, f"#{worn.anchor} .large canvas")


def test_the_charts_numbers_are_those_of_the_valves(page_file: Path, content: PageContent) -> None:
    charts = numbers_on(page_file)["charts"]
    (worn,) = [valve for valve in content.valves if valve.name == "press_1 valve_2"]
    drawn, trend = charts[f"{worn.anchor}-viscous_coefficient"], worn.trends[0]
    # Weekly medians scatter by 0.4 %; from week 14 on the drag falls by 5 % a month.
    before = [value for day, value in zip(drawn["day"], drawn["value"], strict=True) if day < drawn["since"]]
    assert max(map(abs, before)) < 3.0
    assert drawn["value"][-1] == pytest.approx(100.0 * math.expm1(-0.05 * 25 * 7.0 / MONTH), abs=3.0)
    assert all(
        low < value < high
        for low, value, high in zip(drawn["low"], drawn["value"], drawn["high"], strict=True)
    )
    assert drawn["limit"] == 0.2
    assert drawn["since"] == trend.since == pytest.approx(BEGIN / 86_400 + 7 * 14, abs=21.0)
    fitted = drawn["fit"]
    assert fitted["low"] < fitted["end"] < fitted["high"] < fitted["begin"]
    assert fitted["begin"] == 1.0, "no service made another level"
    assert fitted["end"] == pytest.approx(1.0 + trend.change)
    ((first, last, level, half),) = drawn["levels"]
    assert (first, last, level) == (drawn["day"][0], drawn["day"][-1], 1.0)
    assert 0.0 < half < 0.03
    serviced = next(valve for valve in content.valves if valve.machine == "press_10")
    assert charts[f"{serviced.anchor}-viscous_coefficient"]["services"] == [[BEGIN / 86_400 + 100, "O"]]


def test_a_level_ends_at_the_hour_of_its_service(page_file: Path, tmp_path: Path) -> None:
    store = Fabricated(tmp_path / "store")
    store.valve("press", "valve")
    noon = BEGIN + 100 * 86_400 + 43_200
    store.manifest.add_service(Service("press", "", noon * 1_000_000_000, "oil_change", ""))
    out = tmp_path / "fleet.html"
    out.write_text(fleet_page(store.written(), {}), "utf-8")
    before, after = numbers_on(out)["charts"]["valve-1-viscous_coefficient"]["levels"]
    assert before[1] == after[0] == noon / 86_400


#: What keeps the charts that uPlot makes, and the texts that it writes.
WATCH = """
    window.plots = [];
    window.texts = [];
    const write = CanvasRenderingContext2D.prototype.fillText;
    CanvasRenderingContext2D.prototype.fillText = function (text, ...where) {
        texts.push(text);
        return write.call(this, text, ...where);
    };
    let made;
    const construct = (Plot, given) => { const one = new Plot(...given); plots.push(one); return one; };
    Object.defineProperty(window, "uPlot", {
        get: () => made,
        set: (Plot) => { made = new Proxy(Plot, { construct }); },
    });
"""


def test_a_value_beyond_the_scale_is_drawn_at_its_edge(tmp_path: Path, open_page: Callable[..., Any]) -> None:
    store = Fabricated(tmp_path / "store")
    store.valve("press", "valve", range(20))
    for week in range(20, 24):
        store.bag("press", "valve", week, drag=9.0)
    out = tmp_path / "fleet.html"
    out.write_text(fleet_page(store.written(), {}), "utf-8")
    numbers = numbers_on(out)
    high = numbers["scales"]["viscous_coefficient"][1]
    assert numbers["charts"]["valve-1-viscous_coefficient"]["value"][-1] > high
    page = open_page(out, watch=WATCH)
    page.wait_for_selector("canvas")
    rows = page.evaluate("plots[0].data.slice(1)")
    assert [row[-1] for row in rows] == [high] * 3, "value and both ends of its interval"


@pytest.mark.parametrize(("weeks", "form"), [(2, r"\d{4}-\d\d-\d\d"), (WEEKS, r"\d{4}-\d\d")])
def test_charts_of_days_and_of_months_have_iso_dates(
    tmp_path: Path, open_page: Callable[..., Any], weeks: int, form: str
) -> None:
    store = Fabricated(tmp_path / "store")
    store.valve("press", "valve", range(weeks))
    out = tmp_path / "fleet.html"
    out.write_text(fleet_page(store.written(), {}), "utf-8")
    page = open_page(out, "#valve-1", watch=WATCH)
    page.wait_for_selector("#valve-1 .large canvas")
    page.evaluate("new Promise(requestAnimationFrame)")
    # Marks of other axes are numbers, with or without a unit.
    dates = {text for text in page.evaluate("texts") if not re.fullmatch(r"[+-]?[\d.]+( %| °C)?", text)}
    assert len(dates) > 2
    assert all(re.fullmatch(form, text) for text in dates), dates


def numbers_on(file: Path) -> dict[str, Any]:
    """Return the numbers of the charts that a page carries."""
    (text,) = re.findall(
        r'<script type="application/json" id="numbers">(.*?)</script>', file.read_text("utf-8")
    )
    found: dict[str, Any] = json.loads(text)
    return found


def colours_in(page: Any, canvas: str) -> set[str]:
    """Return the names of the page's colours that are drawn on a chart."""
    # uPlot draws after the script that asks for it has ended.
    page.evaluate("new Promise(requestAnimationFrame)")
    found: list[str] = page.evaluate(
        """canvas => {
            const style = getComputedStyle(document.documentElement);
            const { width, height } = canvas;
            const pixels = canvas.getContext("2d").getImageData(0, 0, width, height).data;
            const seen = new Set();
            for (let at = 0; at < pixels.length; at += 4) {
                if (pixels[at + 3] > 250) seen.add([...pixels.subarray(at, at + 3)].join());
            }
            const parts = (text) => text.match(/[0-9a-f]{2}/g).map((one) => parseInt(one, 16)).join();
            const names = ["course", "healthy", "text", "fit", "service"];
            return names.filter((name) => seen.has(parts(style.getPropertyValue("--" + name))));
        }""",
        page.query_selector(canvas),
    )
    return set(found)


def test_markup_in_names_stays_text_and_commands_are_quoted(
    page_file: Path, content: PageContent, open_page: Callable[..., Any]
) -> None:
    (odd,) = [valve for valve in content.valves if valve.machine == EVIL]
    page = open_page(page_file, f"#{odd.anchor}")
    page.wait_for_selector(f"details[open] #{odd.anchor}")
    assert "owned" not in page.title()
    assert page.query_selector("main script, main img") is None
    assert EVIL in page.inner_text("#lights ~ .machine h3")
    assert f"shakes at 15.2 Hz, amplified 4.2 times {EVIL}" in page.inner_text(f"#{odd.anchor}")
    command = next(text for text in page.locator(f"#{odd.anchor} code").all_inner_texts() if "owned" in text)
    assert shlex.split(command)[:4] == ["./spool", "replay", EVIL_BAG, "--report"]


@pytest.mark.parametrize(("scheme", "width"), [("light", 1280), ("dark", 390)])
def test_axe_finds_nothing_serious_and_the_page_fits(
    page_file: Path, open_page: Callable[..., Any], scheme: str, width: int
) -> None:
    page = open_page(page_file, width=width, color_scheme=scheme)
    page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
    # Evaluated by the debugger, which the content security policy does not bind.
    page.evaluate(gzip.decompress(AXE.read_bytes()).decode())
    found = page.evaluate("axe.run(document, { resultTypes: ['violations'] })")
    serious = [
        (one["id"], [node["html"][:200] for node in one["nodes"]][:3])
        for one in found["violations"]
        if one["impact"] in ("serious", "critical")
    ]
    assert serious == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_print_opens_the_valves_that_changed_and_no_others(
    page_file: Path, content: PageContent, open_page: Callable[..., Any]
) -> None:
    page = open_page(page_file, color_scheme="dark")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    shown = {one.get_attribute("id") for one in page.query_selector_all("details[open] .inside")}
    assert shown == {valve.anchor for valve in content.valves if valve.conspicuous}
    assert page.query_selector("details[open] .large:not(:has(canvas)), .small:not(:has(canvas))") is None
    assert "text" in colours_in(page, "details[open] .large canvas"), "dark lines on white paper"
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.query_selector("details[open]") is None


@pytest.mark.slow
def test_reports_are_made_of_bags_that_are_there_and_linked(
    tmp_path: Path,
    open_page: Callable[..., Any],
    capsys: pytest.CaptureFixture[str],
    make_bag: Callable[..., Path],
) -> None:
    store = Fabricated(tmp_path / "store")
    for valve in ("valve_1", "valve_2", "valve_3", "valve_4"):
        store.valve("press_1", valve, wears=0.05 if valve == "valve_2" else 0.0, since=14.0)
    bag = str(make_bag(tmp_path / "bag of <press>", 1))
    store.bag("press_1", "valve_2", WEEKS, path=bag, drag=0.75)
    content = store.written()
    out = tmp_path / "fleet.html"
    made = write_reports(content, out, 2)
    assert list(made) == [bag]
    assert "the bag no longer exists" in capsys.readouterr().err
    out.write_text(fleet_page(content, made), "utf-8")
    (worn,) = [valve for valve in content.valves if valve.valve == "valve_2"]
    page = open_page(out, f"#{worn.anchor}")
    address = page.evaluate(f"document.querySelector('#{worn.anchor} table a').href")
    assert address == (tmp_path / made[bag]).as_uri()
    report = (tmp_path / made[bag]).read_text("utf-8")
    assert "events" in report.lower()
    # A second page takes the report that is there.
    assert write_reports(content, out, 1) == made
    assert (tmp_path / made[bag]).read_text("utf-8") == report


def test_one_bag_of_one_valve_makes_a_page(tmp_path: Path, open_page: Callable[..., Any]) -> None:
    store = Fabricated(tmp_path / "store")
    store.bag("press", "valve", 0)
    content = store.written()
    assert content.summary == "1 valve: 0 changed, 1 learning, 0 unknown"
    out = tmp_path / "fleet.html"
    out.write_text(fleet_page(content, {}), "utf-8")
    page = open_page(out, "#valve-1")
    assert "1 weeks with bags" in page.inner_text("#valve-1")
    assert page.query_selector("#valve-1 .large canvas") is not None


def test_a_fleet_of_damaged_bags_makes_a_page(tmp_path: Path) -> None:
    store = Fabricated(tmp_path / "store")
    store.bag("press", "valve", 0, status="damaged")
    content = store.written()
    assert content.summary == "1 valve: 0 changed, 1 unknown"
    assert "its head is damaged" in fleet_page(content, {})


def test_many_weeks_and_many_bags_do_not_make_a_large_page(tmp_path: Path) -> None:
    """Four years of a valve take no more room than two, so a page is bounded by its number of valves."""
    sizes = []
    for years in (2, 4):
        store = Fabricated(tmp_path / f"store_{years}")
        store.valve("press", "valve", range(52 * years))
        sizes.append(len(fleet_page(store.written(), {})))
    assert sizes[1] < 1.1 * sizes[0]
    empty = len(fleet_page(PageContent(tmp_path, None, None, 0, 0), {}))
    # 200 valves within 5 MB.
    assert 200 * (sizes[1] - empty) + empty < 5e6
