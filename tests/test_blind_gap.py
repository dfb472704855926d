"""The gap workflow on records of a second simulator: bad records are not judged.

What it names right: `research/test/evaluation/test_field_study.py` and `./spool study field`.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spool_blind.field.case import FieldCase, make_field
from spool_blind.files import write, write_record
from spool_blind.simulator import Plant, move
from spool_core.numbers import GRAVITY, Array
from spool_sim.excitation import SweptSine
from spool_sim.integration.composed_motion import ComposedMotion, MotionState, half_step_times
from spool_sim.model import MODELS
from spool_tools.cli import main

VALUES = {"mass": 0.18, "spring_stiffness": 1632.0, "viscous_coefficient": 4.0, "coulomb_force": 0.4}
Samples = tuple[Array, Array, Array]


@dataclass(frozen=True, slots=True)
class Spoiling:
    """Way to spoil a record.

    Attributes:
        spoil: takes and returns (time s, body m/s^2, spool m/s^2), shape (n,) each.
        words: a message that names the matter has one of them.
        usable: the record still holds enough to be judged, with a warning.
    """

    spoil: Callable[[Array, Array, Array], Samples]
    words: tuple[str, ...]
    usable: bool = False


def _too_short(time: Array, body: Array, spool: Array) -> Samples:
    n = int(np.searchsorted(time, 1.0))
    return time[:n], body[:n], spool[:n]


def _no_excitation(time: Array, body: Array, spool: Array) -> Samples:
    generator = np.random.default_rng(0)
    return time, 0.03 * generator.standard_normal(body.size), 0.03 * generator.standard_normal(spool.size)


def _dead_body(time: Array, body: Array, spool: Array) -> Samples:
    return time, np.full_like(body, 0.02), spool


def _dead_spool(time: Array, body: Array, spool: Array) -> Samples:
    return time, body, np.full_like(spool, 0.02)


def _dead_halfway(time: Array, body: Array, spool: Array) -> Samples:
    half = time.size // 2
    return time, body, np.concatenate([spool[:half], np.full(time.size - half, spool[half])])


def _spool_in_g(time: Array, body: Array, spool: Array) -> Samples:
    return time, body, spool / GRAVITY


def _body_in_g(time: Array, body: Array, spool: Array) -> Samples:
    return time, body / GRAVITY, spool


def _swapped(time: Array, body: Array, spool: Array) -> Samples:
    return time, spool, body


def _with_gaps(time: Array, body: Array, spool: Array) -> Samples:
    kept = np.ones(time.size, dtype=bool)
    for start in (0.23, 0.51, 0.74):
        first = int(start * time.size)
        kept[first : first + time.size // 50] = False
    return time[kept], body[kept], spool[kept]


def _slow_sampling(time: Array, body: Array, spool: Array) -> Samples:
    stride = round(1.0 / 200.0 / float(time[1] - time[0]))
    return time[::stride], body[::stride], spool[::stride]


def _turned_sensor(time: Array, body: Array, spool: Array) -> Samples:
    return time, body, -spool


SPOILINGS: dict[str, Spoiling] = {
    "too_short": Spoiling(_too_short, ("short", "seconds", "longer")),
    "no_excitation": Spoiling(_no_excitation, ("excit", "vibrat", "noise", "rest")),
    "dead_body": Spoiling(_dead_body, ("body",)),
    "dead_spool": Spoiling(_dead_spool, ("spool",)),
    "dead_halfway": Spoiling(_dead_halfway, ("spool",), usable=True),
    "spool_in_g": Spoiling(_spool_in_g, ("9.8", "unit", "gain", " g")),
    "body_in_g": Spoiling(_body_in_g, ("9.8", "unit", "gain", " g")),
    "swapped_channels": Spoiling(_swapped, ("swap", "exchang", "interchang")),
    "gaps": Spoiling(_with_gaps, ("gap", "missing", "lost", "stretches"), usable=True),
    "slow_sampling": Spoiling(_slow_sampling, ("sampl", "rate", "Hz")),
    "turned_sensor": Spoiling(_turned_sensor, ("sign", "turned", "polarity", "direction", "opposite")),
}


def test_both_simulators_agree_on_the_motion_with_dry_friction():
    rate, seconds = 2000.0, 10.0
    sweep = SweptSine(start_frequency=8.0, stop_frequency=60.0, duration=seconds, amplitude=10.0)
    forcing = sweep.acceleration(half_step_times(0, round(seconds * rate), rate, 8))
    motion = ComposedMotion(MODELS["coulomb"].terms)
    ours, _ = motion.advance(
        MotionState(), forcing, motion.table(VALUES, 1), sample_period=1.0 / rate, substeps=8
    )
    h = 1.0 / rate / 40
    t = (np.arange(round(seconds / h)) + 0.5) * h
    plant = Plant({"mass": 0.18, "stiffness": 1632.0, "damping": 4.0, "coulomb_force": 0.4})
    other = move(plant, t, h, sweep.acceleration(t))
    samples = np.arange(ours.displacement.size) / rate
    inner = samples > 0.01
    expected = np.interp(samples, t, other.displacement)
    difference = np.std((ours.displacement - expected)[inner]) / np.std(expected)
    assert difference < 1e-3


@lru_cache(maxsize=1)
def good() -> FieldCase:
    return make_field(4, "coulomb_friction", ())


def slow(*values: object) -> Any:
    """A case that is left to the slow tests."""
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize("name", [name for name, spoiling in SPOILINGS.items() if not spoiling.usable])
def test_a_bad_record_is_refused_for_what_is_wrong(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line that names the matter, and no verdict."""
    case, spoiling = good(), SPOILINGS[name]
    write(case, tmp_path)
    record = tmp_path / "bad.csv"
    write_record(record, *spoiling.spoil(case.time, case.body, case.spool))
    code = main(["gap", str(record), "--valve", str(tmp_path / "valve.yaml")])
    said = capsys.readouterr()
    assert code == 2, said
    assert any(word in said.err for word in spoiling.words), said.err
    assert len(said.err.splitlines()) == 1


@pytest.mark.parametrize(
    "name",
    [
        slow(name) if name in ("dead_halfway", "gaps") else name
        for name, spoiling in SPOILINGS.items()
        if spoiling.usable
    ],
)
def test_a_record_that_is_bad_in_part_is_judged_with_a_warning(name: str, tmp_path: Path) -> None:
    case, spoiling = good(), SPOILINGS[name]
    write(case, tmp_path)
    record, found = tmp_path / "bad.csv", tmp_path / "gap.json"
    write_record(record, *spoiling.spoil(case.time, case.body, case.spool))
    code = main(["gap", str(record), "--valve", str(tmp_path / "valve.yaml"), "--json", str(found)])
    assert code in (0, 1)
    result = json.loads(found.read_text("utf-8"))
    assert any(word in line for word in spoiling.words for line in result["warnings"]), result["warnings"]
    assert set(result["verdict"].split("+")) <= {"coulomb_friction", "unexplained"}
