"""The gap workflow on records of a second simulator: what is bad in part is judged with a warning.

What it names right: `research/test/evaluation/test_field_study.py` and `./spool study field`.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from spool_blind.field.case import make_field
from spool_blind.files import write, write_record
from spool_blind.simulator import Plant, move
from spool_core.numbers import Array
from spool_sim.excitation import SweptSine
from spool_sim.integration.composed_motion import ComposedMotion, MotionState, half_step_times
from spool_sim.model import MODELS
from spool_tools.cli import main

VALUES = {"mass": 0.18, "spring_stiffness": 1632.0, "viscous_coefficient": 4.0, "coulomb_force": 0.4}
Samples = tuple[Array, Array, Array]


def dead_halfway(time: Array, body: Array, spool: Array) -> Samples:
    half = time.size // 2
    return time, body, np.concatenate([spool[:half], np.full(time.size - half, spool[half])])


def with_gaps(time: Array, body: Array, spool: Array) -> Samples:
    kept = np.ones(time.size, dtype=bool)
    for start in (0.23, 0.51, 0.74):
        first = int(start * time.size)
        kept[first : first + time.size // 50] = False
    return time[kept], body[kept], spool[kept]


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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "words"), [(dead_halfway, ("spool",)), (with_gaps, ("gap", "missing", "lost", "stretches"))]
)
def test_a_record_that_is_bad_in_part_is_judged_with_a_warning(
    spoil: Callable[[Array, Array, Array], Samples], words: tuple[str, ...], tmp_path: Path
) -> None:
    case = make_field(4, "coulomb_friction", ())
    write(case, tmp_path)
    record, found = tmp_path / "bad.csv", tmp_path / "gap.json"
    write_record(record, *spoil(case.time, case.body, case.spool))
    code = main(["gap", str(record), "--valve", str(tmp_path / "valve.yaml"), "--json", str(found)])
    assert code in (0, 1)
    result = json.loads(found.read_text("utf-8"))
    assert any(word in line for word in words for line in result["warnings"]), result["warnings"]
    assert set(result["verdict"].split("+")) <= {"coulomb_friction", "unexplained"}
