"""Stages of the selection: pure, traced, and each can be left out."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

from hypothesis import given
from hypothesis import strategies as st
from spool_gap.fitting.descent import Fitted
from spool_gap.fitting.hypothesis import Fitting, Hypothesis
from spool_gap.result import Change, RankedHypothesis
from spool_gap.selection.context import Context
from spool_gap.selection.state import SelectionState, Stage, run_stages
from spool_gap.simulation.point import Point
from spool_gap.stages.acceptance import refuse_growth
from spool_gap.stages.growth import BACKWARD, FORWARD
from spool_gap.stages.selection import FINAL, SELECTION

NAMES = st.lists(st.sampled_from(["coulomb_friction", "end_stop", "cubic_stiffness"]), max_size=3)
EVERY = (*SELECTION, *FORWARD, *BACKWARD, *FINAL)


def hypothesis(effects: tuple[str, ...]) -> Hypothesis:
    return Hypothesis(effects, cast("Fitted", SimpleNamespace(point=Point((), {}))))


def accepting(name: str, effects: tuple[str, ...]) -> Stage:
    def stage(_context: Context, state: SelectionState) -> SelectionState:
        return replace(state, accepted=hypothesis(effects))

    stage.__name__ = name
    return stage


def context(*left_out: str) -> Context:
    return cast("Context", SimpleNamespace(left_out=frozenset(left_out)))


def begun() -> SelectionState:
    return SelectionState(cast("object", None), cast("object", None), (), accepted=hypothesis(()))  # type: ignore[arg-type]


@given(choices=st.lists(NAMES.map(tuple), max_size=6))
def test_the_trace_tells_each_stage_that_changed_the_choice(choices: list[tuple[str, ...]]) -> None:
    stages = [accepting(f"stage_{number}", effects) for number, effects in enumerate(choices)]
    before = [(), *choices]
    changes = [
        Change(f"stage_{number}", old, new)
        for number, (old, new) in enumerate(zip(before, choices, strict=False))
        if old != new
    ]
    start = begun()
    assert run_stages(stages, context(), start).trace == tuple(changes)
    assert start.trace == ()


def test_a_stage_that_is_left_out_changes_nothing() -> None:
    stages = [accepting("first", ("end_stop",)), accepting("second", ())]
    assert run_stages(stages, context("second"), begun()).choice == ("end_stop",)
    assert run_stages(stages, context("first", "second"), begun()).choice == ()


def test_a_further_fit_takes_the_place_of_the_first_wherever_that_is_held() -> None:
    old, other, new = hypothesis(("end_stop",)), hypothesis(()), hypothesis(("end_stop",))
    state = replace(begun(), accepted=old, steps=(other, old), tried={("end_stop", ()): old})
    after = state.refitted(old, new)
    assert after.accepted is new
    assert after.steps == (other, new)
    assert after.tried["end_stop", ()] is new
    assert state.accepted is old


@given(errors=st.lists(st.floats(0.01, 1.0), min_size=1, max_size=4))
def test_no_choice_has_a_larger_held_out_error_than_the_base(errors: list[float]) -> None:
    names = ("coulomb_friction", "end_stop", "cubic_stiffness")
    steps = tuple(hypothesis(names[:number]) for number in range(len(errors)))
    known = {id(step): error for step, error in zip(steps, errors, strict=True)}
    fitting = cast("Fitting", SimpleNamespace(nrmse=lambda step: known[id(step)]))
    ranking = tuple(
        RankedHypothesis(names[number], names[:number], error, 50.0, {}, accepted=True)
        for number, error in enumerate(errors[1:])
    )
    state = replace(begun(), fitting=fitting, accepted=steps[-1], steps=steps, ranking=ranking)
    after, said = refuse_growth(state)
    assert known[id(after.hypothesis)] <= errors[0]
    assert after.steps[-1] is after.hypothesis
    assert bool(said) == (errors[-1] > errors[0])
    assert {row.id for row in after.ranking if row.accepted} == set(after.hypothesis.effects)
    refused = [name for name in state.choice if name not in after.choice]
    assert all(name.replace("_", " ") in said[0] for name in refused)


def test_stages_have_names_of_their_own_and_tell_what_they_do() -> None:
    names = [stage.__name__ for stage in EVERY]
    assert len(set(names)) == len(names)
    assert all(stage.__doc__ for stage in EVERY)
