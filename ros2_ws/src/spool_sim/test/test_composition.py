from __future__ import annotations

import os
import pickle
import subprocess
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import spool_sim
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_sim.excitation import SteadySine, SweptSine
from spool_sim.integration.composed_motion import (
    ComposedMotion,
    MotionState,
    Points,
    Trajectory,
    checked_substeps,
    half_step_times,
    halving_error,
    slopes,
    substeps_for,
)
from spool_sim.integration.composition import kernel_of, laws_source
from spool_sim.model import MODELS, model_from_mapping
from spool_sim.terms import TERMS, term
from spool_sim.valve import Valve

SWEEP = SweptSine(start_frequency=8.0, stop_frequency=110.0, duration=3.0, amplitude=10.0, soft_start=0.0)
# Several dry laws, memory, contacts and time together.
EVERYTHING = (
    "inertia",
    "spring",
    "viscous_friction",
    "coulomb_friction",
    "mixed_friction",
    "presliding_friction",
    "end_stop",
    "damping_drift",
    "periodic_force",
)
VALUES = {
    "coulomb_force": 0.2,
    "mixed_inverse_coefficient": 0.001,
    "dahl_force": 0.2,
    "stop_gap": 3e-4,
    "stop_stiffness": 1e5,
    "damping_drift_rate": 0.5,
    "force_amplitude": 0.5,
    "viscous_coefficient": 2.65,
}


def everything() -> tuple[ComposedMotion, dict[str, float]]:
    motion = ComposedMotion([term(name) for name in EVERYTHING])
    return motion, {p.name: p.start for p in motion.parameters} | VALUES


def test_the_laws_of_fluid_in_the_package_are_what_the_composer_writes() -> None:
    text = (Path(spool_sim.__file__).parent / "integration" / "fluid_laws.py").read_text(encoding="utf-8")
    assert text.endswith(laws_source(MODELS["fluid"].terms))


@settings(max_examples=20, deadline=None)
@given(cuts=st.lists(st.integers(1, 399), max_size=8, unique=True), substeps=st.integers(1, 4))
def test_any_split_gives_the_same_numbers(cuts: list[int], substeps: int) -> None:
    motion, values = everything()
    given_values = {**values, "spring_stiffness": np.linspace(1632.0, 1200.0, 400)}
    table = motion.table(given_values, 400)

    def run(state: MotionState, first: int, last: int) -> tuple[Trajectory, MotionState]:
        forcing = SWEEP.acceleration(half_step_times(first, last - first, 2000.0, substeps))
        return motion.advance(
            state, forcing, table[first:last], sample_period=5e-4, substeps=substeps, first_sample=first
        )

    whole, end = run(MotionState(), 0, 400)
    state, parts = MotionState(), []
    for first, last in pairwise([0, *sorted(cuts), 400]):
        part, state = run(state, first, last)
        parts.append(part)
    for name in ("displacement", "velocity", "acceleration", "stuck", "memory"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, getattr(whole, name))
    assert state == end
    assert np.abs(whole.displacement).max() > 3e-4


def test_valves_together_move_as_each_alone() -> None:
    motion, values = everything()
    tables = np.stack([motion.table({**values, "coulomb_force": 0.1 * n}, 500) for n in range(5)])
    bodies = np.stack(
        [(1.0 + 0.1 * n) * SWEEP.acceleration(half_step_times(0, 500, 2000.0, 4)) for n in range(5)]
    )
    start = [MotionState(1e-5 * n) for n in range(5)]
    together, ends = motion.advance_batch(start, bodies, tables, sample_period=5e-4, substeps=4)
    for n in range(5):
        alone, end = motion.advance(start[n], bodies[n], tables[n], sample_period=5e-4, substeps=4)
        np.testing.assert_array_equal(together.displacement[n], alone.displacement)
        np.testing.assert_array_equal(together.memory[n], alone.memory)
        assert ends[n] == end
    many, _ = motion.advance_batch(
        start * 20, np.tile(bodies, (20, 1)), np.tile(tables, (20, 1, 1)), sample_period=5e-4, substeps=4
    )
    np.testing.assert_array_equal(many.displacement, np.tile(together.displacement, (20, 1)))
    shared, _ = motion.advance_batch(start, bodies[:1], tables[:1], sample_period=5e-4, substeps=4)
    np.testing.assert_array_equal(shared.displacement[0], together.displacement[0])
    assert not np.array_equal(shared.displacement[1], shared.displacement[0])
    stands_on, begins = [2, 0, 2, 1, 0], [0, 7, 0, 3, 5]
    mixed, _ = motion.advance_batch(
        start, bodies[:3], tables, sample_period=5e-4, substeps=4, first_sample=begins, stands_on=stands_on
    )
    for n, (body, begin) in enumerate(zip(stands_on, begins, strict=True)):
        alone, _ = motion.advance(
            start[n], bodies[body], tables[n], sample_period=5e-4, substeps=4, first_sample=begin
        )
        np.testing.assert_array_equal(mixed.velocity[n], alone.velocity)


def test_of_many_sets_of_parameters_the_true_one_alone_moves_as_was_measured() -> None:
    """Each set moves as it does alone, however many there are and whatever body it stands on."""
    motion, values = everything()
    samples, count, true = 200, 14, 10
    bodies = np.stack(
        [size * SWEEP.acceleration(half_step_times(0, samples, 2000.0, 4)) for size in (1.0, 2.0)]
    )
    tables = [motion.table({**values, "coulomb_force": 0.2 + 0.05 * n}, 1) for n in range(count)]
    body = np.arange(count) % 2
    measured, _ = motion.advance(
        MotionState(), bodies[body[true]], tables[true], sample_period=5e-4, substeps=4
    )

    def read(places: list[int]) -> list[Points]:
        sets = np.array([tables[n] for n in places])
        return motion.read_batch(
            MotionState(), bodies, sets, rows=body[places], sample_period=5e-4, substeps=4
        )

    together = read(list(range(count)))
    size = np.array([np.abs(one.acceleration[::4] - measured.acceleration).max() for one in together])
    assert size[true] < 1e-9
    assert np.delete(size, true).min() > 1e-3
    for n, one in enumerate(together):
        (alone,) = read([n])
        np.testing.assert_array_equal(one.acceleration, alone.acceleration)
        np.testing.assert_array_equal(one.events, alone.events)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name not in ("coulomb", "stribeck", "fluid_end_stop")))
        for name in sorted(MODELS)
    ],
)
def test_energy_of_any_composition(name: str, valve: Valve, energy_balance: Any) -> None:
    model = MODELS[name]
    motion = ComposedMotion(model.terms)
    values = model.values_for(valve, {"stop_gap": 3e-4} if name == "fluid_end_stop" else None)
    rate = 40_000.0
    forcing = SWEEP.acceleration(half_step_times(0, round(0.5 * rate), rate, 1))
    trajectory, _ = motion.advance(
        MotionState(), forcing, motion.table(values, 1), sample_period=1.0 / rate, substeps=1
    )
    energy = energy_balance(motion, values, trajectory, forcing[:-1:2], sample_period=1.0 / rate)
    turned_over = abs(energy.supplied) + sum(abs(work) for work in energy.taken.values())
    assert energy.supplied > 0.0
    assert abs(energy.residual) < 1e-4 * turned_over
    for entry in motion.terms:
        if entry.dissipates and entry.dissipates_with is None:
            assert energy.taken[entry.name] >= 0.0
    assert set(energy.taken) == {entry.name for entry in motion.terms} - {"inertia"}


def test_everything_together_converges_and_keeps_its_energy(energy_balance: Any) -> None:
    motion, values = everything()
    substeps, error = checked_substeps(
        motion, values, SWEEP.acceleration, seconds=0.5, sample_rate=2000.0, highest_frequency=110.0
    )
    assert error < 1e-3
    assert substeps >= substeps_for(motion.terms, values, 5e-4, 110.0)
    rate = 40_000.0
    forcing = SWEEP.acceleration(half_step_times(0, round(0.5 * rate), rate, 1))
    trajectory, _ = motion.advance(
        MotionState(), forcing, motion.table(values, 1), sample_period=1.0 / rate, substeps=1
    )
    assert 0.0 < trajectory.stuck.mean() < 0.5
    energy = energy_balance(motion, values, trajectory, forcing[:-1:2], sample_period=1.0 / rate)
    assert abs(energy.residual) < 1e-4 * energy.supplied


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high).map(lambda power: float(10.0**power))


@settings(max_examples=60, deadline=None)
@given(
    changes=st.fixed_dictionaries(
        {
            "spring_stiffness": decades(1.0, 5.0),
            "viscous_coefficient": st.just(0.0) | decades(-2.0, 2.0),
            "coulomb_force": st.just(0.0) | decades(-3.0, 1.3),
            "mixed_inverse_coefficient": st.just(0.0) | decades(-4.0, -1.0),
            "dahl_force": decades(-3.0, 0.5),
            "dahl_stiffness": decades(2.0, 6.0),
            "stop_gap": decades(-4.5, -2.3),
            "stop_stiffness": decades(3.0, 6.0),
            "stop_dissipation": st.sampled_from((0.0, 0.5, 20.0)),
            "damping_drift_rate": st.floats(-2.0, 1.0),
        }
    ),
    amplitude=decades(-1.0, 2.0),
    frequency=st.floats(1.0, 200.0),
)
def test_no_parameters_make_energy_appear(
    changes: dict[str, float], amplitude: float, frequency: float, energy_balance: Any
) -> None:
    motion, values = everything()
    values = values | changes
    rate, samples = 20_000.0, 2000
    substeps = substeps_for(motion.terms, values, 1.0 / rate, frequency)
    sine = SteadySine(frequency=frequency, amplitude=amplitude, soft_start=0.0)
    forcing = sine.acceleration(half_step_times(0, samples, rate, substeps))
    trajectory, _ = motion.advance(
        MotionState(), forcing, motion.table(values, 1), sample_period=1.0 / rate, substeps=substeps
    )
    assert np.isfinite(trajectory.acceleration).all()
    assert not trajectory.velocity[trajectory.stuck].any()
    body = forcing[: -1 : 2 * substeps]
    energy = energy_balance(motion, values, trajectory, body, sample_period=1.0 / rate)
    turned_over = abs(energy.supplied) + sum(abs(work) for work in energy.taken.values())
    assert abs(energy.residual) <= 0.01 * turned_over + 1e-12


def test_stiffest_rate_follows_the_stiffest_term() -> None:
    stop = {p.name: p.start for p in TERMS["end_stop"].parameters}
    assert slopes(TERMS["end_stop"], stop)[0] == pytest.approx(1e6, rel=0.3)
    far = {**stop, "stop_gap": 0.09}
    assert slopes(TERMS["end_stop"], far)[0] == pytest.approx(1e6, rel=0.3)
    dahl = {"dahl_force": 0.5, "dahl_stiffness": 5e4}
    assert slopes(TERMS["presliding_friction"], dahl) == (pytest.approx(5e4, rel=1e-3), 0.0)
    assert slopes(TERMS["viscous_friction"], {"viscous_coefficient": 8.0}) == (0.0, pytest.approx(8.0))
    soft = {"mass": 0.18, "spring_stiffness": 1632.0, **stop}
    terms = [TERMS["inertia"], TERMS["spring"], TERMS["end_stop"]]
    stiff = {**soft, "stop_stiffness": 1e8}
    assert substeps_for(terms, stiff, 5e-4) > 8 * substeps_for(terms, soft, 5e-4) > 8
    with pytest.raises(InputError, match="at most"):
        substeps_for(terms, {**stiff, "mass": 1e-4}, 0.1)


def test_a_step_that_is_too_coarse_is_halved(valve: Valve) -> None:
    model = MODELS["fluid_spring_backlash"]
    motion, values = ComposedMotion(model.terms), model.values_for(valve)
    options = {"seconds": 0.5, "sample_rate": 250.0}
    coarse = substeps_for(model.terms, values, 1.0 / 250.0, 1.0)
    error = halving_error(motion, values, SWEEP.acceleration, substeps=coarse, **options)
    chosen, left = checked_substeps(
        motion, values, SWEEP.acceleration, highest_frequency=1.0, tolerance=0.1 * error, **options
    )
    assert chosen > coarse
    assert left <= 0.1 * error


def test_shapes_that_do_not_fit_are_refused() -> None:
    motion, values = everything()
    table = motion.table(values, 10)
    for body, given_table in (
        (np.zeros(20), table),
        (np.zeros(21), table[:, :-1]),
        (np.zeros(21), table[:0]),
    ):
        with pytest.raises(ValueError, match="not"):
            motion.advance(MotionState(), body, given_table, sample_period=1e-3, substeps=1)
    with pytest.raises(ValueError, match="2 states, but 3 bodies"):
        motion.advance_batch(
            [MotionState()] * 2, np.zeros((3, 21)), table[np.newaxis], sample_period=1e-3, substeps=1
        )
    for stands_on in ([0], [0, 3], [-1, 0]):
        with pytest.raises(ValueError, match="one of 3 bodies for each of 2 states"):
            motion.advance_batch(
                [MotionState()] * 2,
                np.zeros((3, 21)),
                table[np.newaxis],
                sample_period=1e-3,
                substeps=1,
                stands_on=stands_on,
            )


NEW_TERM = """
from spool_core.kernels.compiled import compiled
from spool_sim.terms.base import Parameter, Term

@compiled
def pull(magnet_pull: float) -> float:
    return magnet_pull * FACTOR

MAGNET = Term(
    name="magnet",
    parameters=(Parameter("magnet_pull", "N", 0.0, 10.0, 1.0, "pull"),),
    law="F", source="for the test", meaning="a magnet", check="it",
    force_law=pull,
)
"""

#: Moves a valve with the new term of a folder; says how often its kernel was compiled, and where that lies.
LOAD = """
import sys
import numpy as np
from spool_core.discovery import objects_in
import spool_sim.terms as terms
terms.__path__.append(sys.argv[1])
terms.TERMS.update((entry.name, entry) for entry in objects_in(terms.__name__, terms.Term))
from spool_sim.model import model_from_mapping
from spool_sim.integration.composed_motion import ComposedMotion, MotionState
model = model_from_mapping({"name": "m", "terms": ["inertia", "spring", "magnet"]})
motion = ComposedMotion(model.terms)
table = motion.table({p.name: p.start for p in motion.parameters}, 1)
_, end = motion.advance(MotionState(), np.zeros(2001), table, sample_period=1e-4, substeps=1)
stats = motion._kernel.advance_batch_kernel.stats
print(sum(stats.cache_misses.values()), stats.cache_path, end.displacement)
"""


@dataclass(frozen=True)
class Load:
    """What a separate process reported: kernels that it compiled, where they lie, the displacement (m)."""

    compiled: int
    place: Path
    displacement: float


def load(folder: Path, factor: str, code: str = LOAD) -> Load:
    """Run ``code`` in a separate process, with the new term times ``factor`` and a cache of kernels."""
    (folder / "magnet.py").write_text(NEW_TERM.replace("FACTOR", factor), "utf-8")
    done = subprocess.run(
        # Python would take its own bytecode for a file that changes twice in a second, keeping its length.
        [sys.executable, "-B", "-c", code, str(folder)],
        capture_output=True,
        text=True,
        check=False,
        env={
            **os.environ,
            "PYTHONPATH": ":".join(path for path in sys.path if path),
            "NUMBA_CACHE_DIR": str(folder),
        },
    )
    assert done.returncode == 0, done.stderr
    compiled, place, displacement = done.stdout.split()
    return Load(int(compiled), Path(place), float(displacement))


@pytest.fixture(scope="module")
def loads(tmp_path_factory: pytest.TempPathFactory) -> tuple[Load, Load, Load]:
    """Return three processes, one after the other: the term new, unchanged, and with another law."""
    pytest.importorskip("numba")
    folder = tmp_path_factory.mktemp("kernels")
    first, later, changed = (load(folder, factor) for factor in ("1.0", "1.0", "2.0"))
    assert first.place.parent == folder
    return first, later, changed


def test_first_use_compiles_and_later_processes_load(loads: tuple[Load, Load, Load]) -> None:
    first, later, _ = loads
    assert first.compiled > 0
    assert later.compiled == 0


def test_a_new_term_is_one_new_file_and_a_changed_law_is_never_served_stale(
    loads: tuple[Load, Load, Load],
) -> None:
    first, later, changed = loads
    assert first.displacement == later.displacement < 0.0
    assert changed.displacement == pytest.approx(2.0 * first.displacement)


def test_the_same_list_is_the_same_kernel_and_another_order_another() -> None:
    names = MODELS["fluid"].terms
    assert kernel_of(names) is kernel_of(names)
    other = kernel_of((names[0], names[2], names[1]))
    assert other.__name__ != kernel_of(names).__name__


def test_models_from_files_take_any_list() -> None:
    model = model_from_mapping({"name": "all", "terms": list(EVERYTHING), "parameters": {"dahl_force": 0.3}})
    assert [p.name for p in model.parameters].count("viscous_coefficient") == 1


@pytest.mark.parametrize("name", list(MODELS))
def test_a_model_goes_to_another_process(name: str) -> None:
    assert pickle.loads(pickle.dumps(MODELS[name])) == MODELS[name]
