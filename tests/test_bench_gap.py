"""The peer of the gap workflow in the benchmarks gets a fair chance."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from rich.console import Console
from spool_blind.field.case import make_field
from spool_evaluation.bench import run_bench, table_of
from spool_evaluation.results.timing import Timing
from spool_evaluation.studies.estimation import given
from spool_gap.catalogue import EFFECTS
from spool_gap.effect import Motion


@pytest.fixture(name="peer")
def _peer(monkeypatch):
    """The peer, with one of the settings that it searches, which does well; PySINDy takes 1 s to import."""
    peer = importlib.import_module("spool_evaluation.benchmarks.gap")
    monkeypatch.setattr(peer, "THRESHOLDS", (0.02, 0.05))
    monkeypatch.setattr(peer, "RIDGES", (1e-3,))
    monkeypatch.setattr(peer, "LARGEST", 2000)
    return peer


@pytest.mark.slow
def test_pysindy_finds_a_hardening_spring_from_the_library(peer):
    found = peer.library(*given(make_field(6, "cubic_stiffness", ())))
    assert "cubic_stiffness" in peer.named(found, ensemble=False)


def test_the_library_holds_every_shape_of_every_law_of_the_catalogue(peer):
    found = peer.library(*given(make_field(6, "cubic_stiffness", ())))
    n = 1000
    wave = np.sin(np.linspace(0.0, 50.0, n))
    motion = Motion(wave, wave, wave, np.arange(n) * 1e-3, 1e-3, 0.0, 0.18, 1632.0, 4.0, (50.0,) * peer.LINES)
    for effect in EFFECTS.values():
        if "accelerations" in effect.kinds and effect.terms:
            shapes = [effect.signature(motion, one).shape[0] for one in effect.shapes(motion)]
            assert found.owners.count(effect.id) == sum(shapes) > 0


def test_a_sine_from_outside_is_offered_at_its_own_frequency(peer):
    case = make_field(6, "periodic_force", ())
    record, valve = given(case)
    conditioning = peer.ZeroPhase(record.sample_period, peer.LOW_CUT)
    motion = peer.relative_motion(record.body, record.spool, conditioning)
    offered = peer._lines(valve.moving_mass * motion.spool, motion, record.sample_period)
    wanted = case.truth["periodic_force"]["force_frequency"]
    assert min(abs(frequency - wanted) for frequency in offered) < 0.2


def test_the_records_are_fresh_and_hide_only_what_a_library_can_hold(peer):
    chosen = peer.seeds(8)
    assert len(set(chosen)) == 8
    assert min(chosen) >= peer.FRESH
    assert min(peer.seeds(2, 50_000)) >= 50_000


@pytest.mark.slow
def test_the_benchmark_runs_on_any_seed(peer, monkeypatch, tmp_path):
    monkeypatch.setattr(peer, "PEERS", {"PySINDy STLSQ": False})
    run_bench("gap", tmp_path / "bench.json", seed=40_000, cases=1)
    assert "from seed 40000" in (tmp_path / "bench.json").read_text("utf-8")


def test_errors_are_shown_where_there_are_any():
    timed, judged = Timing("a", "b", 1.0, 2.0), Timing("c", "d", 1.0, 2.0, 0.125, 0.5)
    console = Console(width=140, record=True)
    console.print(table_of([timed, judged]))
    console.print(table_of([timed]))
    both, alone = console.export_text().split("work ")[1:]
    assert "their error" in both
    assert "0.125" in both
    assert "error" not in alone
