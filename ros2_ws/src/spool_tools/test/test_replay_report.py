"""`./spool replay --report`: what the monitor's tests saw, drawn from its own numbers."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from spool_core.block import Block
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.detectors import MonitorSettings
from spool_monitor.drift_trace import DriftTrace
from spool_monitor.event import EventState
from spool_monitor.monitor import Monitor
from spool_monitor.replay import Replay
from spool_sim.excitation import PRESETS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve
from spool_tools.cli import main

VALVE = find_valve("4weh10_soft")


def worn(seconds: float = 40.0) -> list[Block]:
    """Return a valve whose drag falls to half within 5 s, from the middle of the record on."""
    sensor = Sensor(noise=0.05)
    simulator = Simulator(
        VALVE, PRESETS["multisine"], coulomb_force=0.3, body_sensor=sensor, spool_sensor=sensor
    )
    blocks = list(simulator.records(0.5 * seconds))
    simulator.set_drift("viscous_coefficient", 0.5 * VALVE.viscous_coefficient, 5.0)
    return [*blocks, *simulator.records(0.5 * seconds)]


def write(path: Path, blocks: list[Block]) -> Path:
    body, spool = (np.concatenate([getattr(block, name) for block in blocks]) for name in ("body", "spool"))
    time = blocks[0].sample_period * np.arange(body.size)
    names = "time_s,body_m_s2,spool_m_s2"
    table = np.transpose([time, body, spool])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=names, comments="")
    return path


def report(record: Path) -> str:
    file = record.with_suffix(".html")
    assert main(["replay", str(record), "--valve", "4weh10_soft", "--report", str(file)]) == 0
    return file.read_text(encoding="utf-8")


@pytest.fixture(scope="module", name="page")
def _page(tmp_path_factory: pytest.TempPathFactory) -> str:
    return report(write(tmp_path_factory.mktemp("replayed") / "worn.csv", worn()))


def test_the_trace_holds_the_numbers_that_raised_the_event() -> None:
    trace = DriftTrace()
    monitor = Monitor(MonitorSettings(natural_frequency=VALVE.natural_frequency))
    one = Replay(Estimator(settings_for(VALVE)), monitor, trace=trace)
    one.run(worn())
    event = next(
        event for event in one.events if event.kind == "friction_drift" and event.state is EventState.RAISED
    )
    points = trace.points["viscous_coefficient"]
    drift = monitor.detection.parameters["viscous_coefficient"]
    assert points[-1].down == drift.sum.down
    assert points[-1].threshold == drift.threshold
    assert points[-1].baseline == drift.baseline.value
    crossed = next(point.stamp for point in points if point.down >= point.threshold)
    # The event comes when the sum has crossed, the change is four of its deviations, for the on delay of 2 s.
    assert 2.0 - 0.01 <= (event.stamp - crossed) * 1e-9 < 9.0
    assert crossed * 1e-9 - 20.0 > one.first_stamp * 1e-9


def test_the_page_says_what_drifted_and_shows_it(page: str) -> None:
    for title in ("viscous coefficient", "Coulomb force", "spring stiffness"):
        assert f"<h3>Drift of the {title}</h3>" in page
    drift = page[page.index("<h3>Drift of the viscous coefficient</h3>") :]
    caption = drift[drift.index("<figcaption>") : drift.index("</figcaption>")]
    crossing = re.search(r"first crosses its threshold at ([0-9.]+) s", caption)
    assert crossing is not None
    assert 20.0 < float(crossing[1]) < 35.0
    assert "Friction drift (wear): viscous coefficient " in page
    assert "<li>Limit: " in page
    for title in ("Spectrum over time", "Transmissibility", "Force loops"):
        assert title in page


def test_the_page_is_one_small_file(page: str) -> None:
    assert len(page.encode()) < 2_000_000
    outside_pictures = re.sub(r"base64,[A-Za-z0-9+/=]+", "", page)
    assert not re.search(r"https?:", outside_pictures)


@pytest.mark.parametrize("case", ["short", "still", "stuck"])
def test_a_page_is_written_of_any_record(case: str, tmp_path: Path) -> None:
    blocks = worn(4.0 if case == "short" else 12.0)
    record = write(tmp_path / f"{case}.csv", blocks)
    if case != "short":
        table = np.loadtxt(record, delimiter=",", skiprows=1)
        noise = 0.02 * np.random.default_rng(0).standard_normal((table.shape[0], 2))
        table[:, 2] = table[:, 1]
        if case == "still":
            table[:, 1:] = 0.0
        table[:, 1:] += noise
        np.savetxt(
            record, table, fmt="%.9g", delimiter=",", header="time_s,body_m_s2,spool_m_s2", comments=""
        )
    page = report(record)
    assert page.count("<h3>") >= 4
    assert page.count("<figcaption>") + page.count("Left out: ") == page.count("<h3>")
