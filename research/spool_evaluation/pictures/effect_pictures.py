"""Catalogue page of the gap analysis: pictures of signatures, laws, what to check.

Made from the registered effects themselves: python -m spool_evaluation.pictures.effect_pictures docs
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from spool_core.numbers import Array
from spool_gap.catalogue import EFFECTS
from spool_gap.effect import Effect, Motion, SensorEffect

from spool_evaluation.results.page import MarkedPage, sentence

LEFT, LAW = "#0072B2", "#D55E00"
PAGE = MarkedPage("effects", "effects")
#: Parts of the motion that signatures are drawn for: frequency (Hz), amplitude (m), phase (rad).
LINES = ((15.0, 1.5e-3, 0.0), (23.0, 0.6e-3, 1.0), (6.0, 0.8e-3, 2.0))
STIFFNESS, DAMPING = 1632.0, 4.0
OUTSIDE = "Forces from outside, changes with time"
CHANNELS = "Sensors and data channels"
GROUPS = ("Dry friction", "Drag and springs", OUTSIDE, CHANNELS)


def shown_motion() -> Motion:
    """Return the motion that every signature is drawn for."""
    time: Array = np.arange(0.0, 2.0, 2e-4, dtype=np.float64)
    z, v, a = np.zeros(time.size), np.zeros(time.size), np.zeros(time.size)
    for frequency, amplitude, phase in LINES:
        turn = 2.0 * np.pi * frequency
        z += amplitude * np.sin(turn * time + phase)
        v += turn * amplitude * np.cos(turn * time + phase)
        a -= turn**2 * amplitude * np.sin(turn * time + phase)
    return Motion(z, v, a, time, 2e-4, 1e-6, 0.18, STIFFNESS, DAMPING, (47.0,))


def signature(entry: Effect, motion: Motion) -> tuple[Array, Array]:
    """Return the force of ``entry`` (largest value 1) and its remainder after a fit of spring and drag."""
    shapes = entry.shapes(motion)
    rows = entry.signature(motion, shapes[len(shapes) // 2])
    force = rows[0] if entry.id != "asymmetric_friction" else rows.sum(axis=0) - 0.6 * rows[1]
    force = force / np.abs(force).max()
    base = np.array([motion.displacement, motion.velocity]).T
    taken, _, _, _ = np.linalg.lstsq(base, force, rcond=None)
    return force, force - base @ taken


def draw(entry: Effect) -> Figure:
    """Return the picture of one signature."""
    figure = Figure(figsize=(4.2, 3.0), layout="constrained")
    axis = figure.subplots()
    motion = shown_motion()
    axis.set_title(entry.id.replace("_", " "), fontsize=10)
    axis.grid(alpha=0.3)
    if isinstance(entry, SensorEffect):
        _draw_channel(axis, entry, motion)
    else:
        _draw_force(axis, entry, motion)
    return figure


def _draw_force(axis: Axes, entry: Effect, motion: Motion) -> None:
    force, left = signature(entry, motion)
    over, label = {
        "velocity": (motion.velocity, "relative velocity, m/s"),
        "displacement": (1e3 * motion.displacement, "relative displacement, mm"),
        "time": (motion.time, "time, s"),
    }[entry.picture]
    some = slice(None) if entry.picture != "time" else slice(0, motion.time.size // 4)
    axis.plot(over[some], force[some], ".", ms=0.8, color=LAW, label="its force")
    axis.plot(over[some], left[some], ".", ms=0.8, color=LEFT, label="left once spring and drag took theirs")
    axis.set_xlabel(label)
    axis.set_ylabel("force over its largest, 1")
    axis.legend(fontsize=6.5, markerscale=8)


def _draw_channel(axis: Axes, entry: SensorEffect, motion: Motion) -> None:
    part = slice(0, 600)
    typical = {number.name: number.start for number in entry.numbers}
    reading = entry.reading(motion.acceleration, motion.period, typical)
    axis.plot(motion.time[part], motion.acceleration[part], color=LAW, label="acceleration")
    axis.plot(motion.time[part], reading[part], color=LEFT, label="reading")
    axis.set_xlabel("time, s")
    axis.set_ylabel("spool, m/s²")
    axis.legend(fontsize=7)


def group(entry: Effect) -> str:
    """Return the heading under which ``entry`` stands."""
    if isinstance(entry, SensorEffect):
        return CHANNELS
    if entry.picture == "time":
        return OUTSIDE
    return "Dry friction" if entry.is_friction else "Drag and springs"


def effects_text() -> str:
    """Return the Markdown of every effect."""
    parts = []
    for title in GROUPS:
        parts.append(f"### {title}\n")
        parts += [_one_effect(entry) for entry in EFFECTS.values() if group(entry) == title]
    return "\n".join(parts)


def _one_effect(entry: Effect) -> str:
    numbers = ", ".join(f"`{number.name}` ({number.unit})" for number in entry.numbers)
    alike = ", ".join(f"`{name}`" for name in entry.confusable_with) or "nothing of the catalogue"
    kinds = "" if len(entry.kinds) == 3 else f" Seen in records of kind {', '.join(entry.kinds)}."
    return (
        f"#### `{entry.id}`\n\n    {entry.law}\n\n"
        f"{sentence(entry.on_the_machine)} Check: {entry.to_check}.{kinds}\n\n"
        f"![signature of {entry.id}](effects/{entry.id}.png)\n\n"
        f"Numbers: {numbers}. Confused with: {alike}. Distinguished by: {entry.distinguished_by}.\n"
    )


if __name__ == "__main__":
    PAGE.write(Path(sys.argv[1]), effects_text(), {name: draw(entry) for name, entry in EFFECTS.items()})
