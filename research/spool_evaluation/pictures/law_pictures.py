"""Force law page: a picture of every law, force against velocity, displacement or time.

Made from the registered terms: ./spool python -m spool_evaluation.pictures.law_pictures docs/methods
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from spool_core.numbers import Array
from spool_sim.terms import TERMS, Term
from spool_sim.valve import Valve, find_valve

from spool_evaluation.results.page import MarkedPage, sentence

FORCE, REST = "#0072B2", "#D55E00"
#: How far (m, s) laws are drawn that do not depend on the velocity; others with a potential as below.
OVER_DISPLACEMENT = {
    "end_stop": 45e-4, "play_friction": 3e-4, "presliding_friction": 4e-5, "spring_backlash": 4e-4,
    "spring_preload": 1e-4,
}  # fmt: skip
OVER_TIME = {"periodic_force": 0.1, "damping_drift": 60.0}
LARGEST_DISPLACEMENT, LARGEST_SPEED = 0.006, 0.2
#: Values other than the start values, where those would not show the law.
SHOWN = {"coulomb_hydrodynamic_friction": {"film_coefficient": 0.05}}
PAGE = MarkedPage("physics", "laws")
GROUPS: dict[str, tuple[str, ...]] = {
    "The balance of forces": ("inertia", "spring", "viscous_friction"),
    "Friction of the paper's models 1 to 3": (
        "microwedge_friction", "mixed_friction", "coulomb_hydrodynamic_friction",
    ),
    "Friction laws that the paper cites": (
        "hess_soom_friction", "pavelescu_friction", "tustin_friction", "adhesion_friction",
        "detachment_friction", "seal_friction",
    ),
}  # fmt: skip


def draw(entry: Term, valve: Valve) -> Figure:
    """Return the picture of one law at its start values for ``valve``."""
    values = {parameter.name: parameter.start_for(valve) for parameter in entry.parameters}
    values |= SHOWN.get(entry.name, {})
    figure = Figure(figsize=(4.2, 3.0), layout="constrained")
    axis = figure.subplots()
    if entry.name == "inertia":
        acceleration = np.array([-20.0, 20.0])
        axis.plot(acceleration, values["mass"] * acceleration, color=FORCE)
        axis.set_xlabel("acceleration of the spool, m/s²")
    elif "memory_law" in entry.laws:
        _draw_loop(axis, entry, values)
    elif entry.name in OVER_DISPLACEMENT or entry.conserves:
        reach = OVER_DISPLACEMENT.get(entry.name, LARGEST_DISPLACEMENT)
        place: Array = np.linspace(-1.0, 1.0, 2001, dtype=np.float64) * reach
        force = entry.force(place, np.zeros(place.size), np.zeros(place.size), values)
        axis.plot(1e3 * place, force, color=FORCE)
        axis.set_xlabel("relative displacement, mm")
    elif entry.name in OVER_TIME:
        time: Array = np.linspace(0.0, OVER_TIME[entry.name], 500, dtype=np.float64)
        moving = np.full(time.size, 0.1)
        axis.plot(time, entry.force(np.zeros(time.size), moving, moving, values, time), color=FORCE)
        axis.set_xlabel("time, s" + (" (at 0.1 m/s)" if entry.name == "damping_drift" else ""))
    else:
        _draw_over_velocity(axis, entry, values)
    axis.axhline(0.0, color="#888888", lw=0.6)
    axis.set_ylabel("force, N")
    axis.set_title(entry.name.replace("_", " "), fontsize=10)
    axis.grid(alpha=0.3)
    return figure


def _draw_over_velocity(axis: Axes, entry: Term, values: dict[str, float]) -> None:
    speed: Array = np.geomspace(1e-6, LARGEST_SPEED, 600, dtype=np.float64)
    for side in (-1.0, 1.0):
        velocity: Array = side * speed
        nothing = np.zeros(speed.size)
        axis.plot(velocity, entry.force(nothing, velocity, nothing, values), color=FORCE)
    low, high = entry.at_rest(0.0, values)
    if high > low:
        axis.plot([0.0, 0.0], [low, high], color=REST, lw=2.5, label="at rest: any of these")
        axis.legend(fontsize=7)
    axis.axvline(0.0, color="#888888", lw=0.6)
    axis.set_xlabel("relative velocity, m/s")


def _draw_loop(axis: Axes, entry: Term, values: dict[str, float]) -> None:
    """Draw the hysteresis loop: the force over a to and fro."""
    reach = OVER_DISPLACEMENT.get(entry.name, LARGEST_DISPLACEMENT)
    way = reach * np.concatenate((np.linspace(0.0, 1.0, 200), np.linspace(1.0, -1.0, 400)[1:]))
    way = np.concatenate((way, reach * np.linspace(-1.0, 1.0, 400)[1:]))
    axis.plot(1e3 * way, entry.force(way, way, way, values), color=FORCE)
    axis.set_xlabel("relative displacement, mm")


def law_text() -> str:
    """Return the Markdown of every registered law: equation, parameters, source, meaning and picture."""
    grouped = {name for names in GROUPS.values() for name in names}
    groups = {
        **GROUPS,
        "Further dry friction and effects": tuple(name for name in TERMS if name not in grouped),
    }
    parts = []
    for title, names in groups.items():
        parts.append(f"### {title}\n")
        parts += [_one_law(TERMS[name]) for name in names]
    return "\n".join(parts)


def _one_law(entry: Term) -> str:
    rows = "\n".join(
        f"| `{given.name}` | {given.unit} | {given.low:g} to {given.high:g} | {given.meaning} |"
        for given in entry.parameters
    )
    shown = SHOWN.get(entry.name, {})
    note = "".join(f" Drawn with `{name}` = {value:g}." for name, value in shown.items())
    return (
        f"#### `{entry.name}`\n\n    {entry.law}\n\n"
        f"{sentence(entry.meaning)} Check on the machine: {entry.check}.{note}\n\n"
        f"Source: {entry.source}.\n\n"
        f"![force of {entry.name}](laws/{entry.name}.png)\n\n"
        f"| parameter | unit | range | |\n|---|---|---|---|\n{rows}\n"
    )


if __name__ == "__main__":
    soft = find_valve("4weh10_soft")
    PAGE.write(Path(sys.argv[1]), law_text(), {name: draw(entry, soft) for name, entry in TERMS.items()})
