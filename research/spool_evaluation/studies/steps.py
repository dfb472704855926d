"""Convergence study: the error of the simulated motion over the time step, by model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from spool_sim.excitation import SweptSine
from spool_sim.integration.composed_motion import ComposedMotion, MotionState, half_step_times
from spool_sim.model import MODELS
from spool_sim.valve import find_valve

from spool_evaluation.results.page import markdown_table, save_picture, write_page
from spool_evaluation.studies.workers import spread

PAGE = "time_steps.md"
TITLE = "Convergence of the time integration"
ABOUT = (
    "Relative rms error of the displacement in 2 s of a sweep from 8 to 110 Hz at 10 m/s², against the same "
    "with a step of 3.9 us; order is the power with which the error falls. What is integrated, and how: "
    "[physics](../methods/physics.md)."
)
#: Of ``STEPS``, how many the table shows.
SHOWN_STEPS = 4


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> dict[str, list[float]]:  # noqa: ARG001 - not drawn
    """Compute the errors of the first ``cases`` models; ``out`` gets the table and the picture."""
    names = list(SHOWN)[:cases]
    unordered = dict(spread(judge, names, "models", workers))
    found = {name: unordered[name] for name in names}
    parts = [ABOUT, table(found), f"![error over time step]({write_picture(found, out).name})"]
    write_page(out / PAGE, TITLE, f"./spool study steps --cases {len(names)} --out DIR", parts)
    print(table(found))
    return found


def judge(name: str) -> tuple[str, list[float]]:
    """Return ``name`` and its relative rms errors for each of ``STEPS``."""
    return name, errors(name, SHOWN[name][0])


def order(found: Sequence[float]) -> float:
    """Return the power of the step that the error falls with, over four halvings."""
    return math.log2(found[0] / found[4]) / 4.0


def table(found: dict[str, list[float]]) -> str:
    """Return the errors as Markdown."""
    body = []
    for name, these in found.items():
        cells = [f"{error:.1e}".replace("e-0", "e-") for error in these[:SHOWN_STEPS]]
        body.append((f"`{name}`", *cells, f"{order(these):.1f}"))
    steps = [f"at {1e6 / SAMPLE_RATE / count:g} us" for count in STEPS[:SHOWN_STEPS]]
    return markdown_table(("model", *steps, "order"), body)


#: Models with what differs from their start values, a colour and a marker each.
SHOWN = {
    "fluid": ({}, "#CC79A7", "D"),
    "coulomb": ({}, "#000000", "v"),
    "microwedge": ({}, "#E69F00", "o"),
    "mixed": ({}, "#0072B2", "s"),
    "coulomb_hydrodynamic": ({"film_coefficient": 0.3}, "#009E73", "^"),
    "fluid_presliding_friction": ({}, "#D55E00", "P"),
}
SECONDS, SAMPLE_RATE = 2.0, 2000.0
STEPS = (1, 2, 4, 8, 16, 32)
REFERENCE = 128


def displacement(name: str, values: dict[str, float], substeps: int) -> NDArray[np.float64]:
    """Return the relative displacement (m) during a sweep from 8 to 110 Hz at 10 m/s^2."""
    valve, model = find_valve("4weh10_soft"), MODELS[name]
    sweep = SweptSine(start_frequency=8.0, stop_frequency=110.0, duration=SECONDS, amplitude=10.0)
    motion = ComposedMotion(model.terms)
    samples = round(SECONDS * SAMPLE_RATE)
    trajectory, _ = motion.advance(
        MotionState(),
        sweep.acceleration(half_step_times(0, samples, SAMPLE_RATE, substeps)),
        motion.table(model.values_for(valve, values), samples),
        sample_period=1.0 / SAMPLE_RATE,
        substeps=substeps,
    )
    return trajectory.displacement


def errors(name: str, values: dict[str, float]) -> list[float]:
    """Return the relative rms error of the displacement for each of ``STEPS``, against ``REFERENCE``."""
    fine = displacement(name, values, REFERENCE)
    return [
        float(np.sqrt(np.mean((displacement(name, values, count) - fine) ** 2) / np.mean(fine**2)))
        for count in STEPS
    ]


def write_picture(found: Mapping[str, Sequence[float]], folder: Path) -> Path:
    """Write ``convergence.png``, the errors of each model for each of ``STEPS``, into ``folder``."""
    step = 1e6 / SAMPLE_RATE / np.array(STEPS)
    figure = Figure(figsize=(6, 4), layout="constrained")
    axis = figure.subplots()
    for name, these in found.items():
        _, colour, marker = SHOWN[name]
        axis.loglog(step, these, color=colour, marker=marker, ms=4, label=name)
    axis.set_xlabel("time step, µs")
    axis.set_ylabel("displacement error, relative rms")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    return save_picture(figure, folder / "convergence.png", dpi=90)
