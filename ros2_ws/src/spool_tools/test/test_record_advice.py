"""One record, one advice: what `check` reports of a faulty record, the other commands report, too."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from spool_core.block import joined
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_gap.evidence.look import look_at
from spool_report.records.record_loading import load_data, load_recording
from spool_report.requests import Selection
from spool_sim.excitation import SweptSine
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve
from spool_tools.cli import main

RATE = 1000.0
VALVE = ("--valve", "4weh10_soft")
Pair = tuple[Array, Array]


@pytest.fixture(scope="module", name="pair")
def _pair() -> Pair:
    """Body and spool of a sound valve, 20 s."""
    sensor = Sensor(noise=0.03)
    sweep = SweptSine(start_frequency=6.0, stop_frequency=80.0, duration=20.0, amplitude=9.0)
    simulator = Simulator(
        find_valve("4weh10_soft"), sweep, model="fluid", sample_rate=RATE, body_sensor=sensor,
        spool_sensor=sensor,
    )  # fmt: skip
    run = joined(list(simulator.records(20.0)))
    return run.body.astype(np.float64), run.spool.astype(np.float64)


def noise(row: Array, seed: int = 1) -> Array:
    return np.asarray(0.03 * np.random.default_rng(seed).standard_normal(row.size))


def clipped(body: Array, spool: Array) -> Pair:
    limit = 0.7 * float(np.abs(spool).max())
    return body, np.clip(spool, -limit, limit)


ALL = ("check", "look", "fit", "gap", "valve check")
#: Samples with a fault and their rate, the advice, and who gives it.
CASES: dict[str, tuple[Callable[[Array, Array], Pair], float, str, tuple[str, ...]]] = {
    "short": (
        lambda body, spool: (body[:1500], spool[:1500]),
        RATE,
        "1.5 s, the longest stretch without gaps 1.5 s: record 20 s or more (20 periods at 1 Hz), by which "
        "every analysis is served",
        ALL,
    ),
    "dead": (
        lambda body, spool: (body, np.full_like(spool, 0.02)),
        RATE,
        "spool reads 0.02 m/s^2 throughout: check sensor and cable",
        ALL,
    ),
    "stopped": (
        lambda body, spool: (body, np.where(np.arange(spool.size) < 2000, 0.02, spool)),
        RATE,
        "spool does not change for 2.0 s: check sensor and cable",
        ALL,
    ),
    "still": (
        lambda body, spool: (noise(body), noise(spool, 2)),
        RATE,
        "no excitation: body has 0.0298 m/s^2 rms, its noise 0.0294: shake the body harder, at 10 to 100 Hz",
        ALL,
    ),
    "body not mounted": (
        lambda body, spool: (noise(body), spool),
        RATE,
        "body shows only noise (0.0298 m/s^2) while spool moves: is its sensor dead, or not mounted?",
        ALL,
    ),
    "spool not mounted": (
        lambda body, spool: (body, noise(spool)),
        RATE,
        "is its sensor dead, or not mounted?",
        ALL,
    ),
    "clipped": (clipped, RATE, "spool clips at ", ALL),
    "incoherent": (
        lambda body, spool: (body, np.roll(spool, 7919)),
        RATE,
        "same valve, same clock, sensors tight?",
        ALL,
    ),
    "slow": (
        lambda body, spool: (body[::5], spool[::5]),
        RATE / 5.0,
        "200 Hz is too slow for `gap`",
        ("check", "look", "gap"),
    ),
    "exchanged": (
        lambda body, spool: (spool, body),
        RATE,
        "body and spool look exchanged: the one that should follow leads: swap the columns",
        ("fit", "gap", "valve check"),
    ),
}


def of_check(path: Path) -> str:
    main(["check", str(path)])
    return ""


def of_look(path: Path) -> str:
    main(["import", str(path), "--look"])
    return ""


def of_fit(path: Path) -> str:
    """Return what `fit` says of a record before it fits."""
    try:
        return "\n".join(load_data([path], "4weh10_soft", Selection()).doubts)
    except InputError as error:
        return str(error)


def of_gap(path: Path) -> str:
    """Return what `gap` says of a record before it searches."""
    try:
        return "\n".join(look_at(load_recording(path).stretches, (), find_valve("4weh10_soft")).warnings)
    except InputError as error:
        return str(error)


def of_valve_check(path: Path) -> str:
    main(["valve", "check", "4weh10_soft", "--record", str(path)])
    return ""


COMMANDS = {"check": of_check, "look": of_look, "fit": of_fit, "gap": of_gap, "valve check": of_valve_check}


@pytest.mark.parametrize("fault", CASES)
def test_each_command_gives_the_same_advice_for_a_record(
    fault: str, pair: Pair, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    spoil, rate, advice, speakers = CASES[fault]
    rows = np.column_stack(spoil(*pair))
    path = tmp_path / "record.csv"
    time = np.arange(len(rows)) / rate
    np.savetxt(
        path, np.c_[time, rows], fmt="%.4f", delimiter=",", header="time_s,body_m_s2,spool_m_s2", comments=""
    )
    heard = {}
    for name in speakers:
        text = COMMANDS[name](path)
        printed = capfd.readouterr()
        lines = [line for line in (text + printed.out + printed.err).splitlines() if advice in line]
        assert lines, (name, text)
        # Without a valve file the natural frequency is that of the record.
        heard[name] = re.sub(r"[\d.]+", "#", lines[0][lines[0].index(advice) :])
    assert len(set(heard.values())) == 1, heard


@pytest.mark.parametrize(
    ("options", "advice"),
    [
        (("--seconds", "1.5"), "record 20 s or more (20 periods at 1 Hz), by which every analysis is served"),
        (("--question", "which_effect", "--seconds", "5"), "too short for `gap`, which needs 6 s"),
        (("--sample-rate", "50"), "50 Hz is too slow for an estimate, which needs 61 Hz"),
    ],
)
def test_a_plan_is_refused_as_its_record_would_be(
    options: tuple[str, ...], advice: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan", *VALVE, "--question", "viscous_coefficient", *options]) == 2
    assert advice in capfd.readouterr().err


def test_a_plan_of_weak_shaking_is_advised_as_its_record_would_be(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", *VALVE, "--question", "viscous_coefficient", "--excitation", "standstill"]) == 1
    assert "shake the body harder, at 10 to 100 Hz, or use a finer sensor" in capfd.readouterr().out
