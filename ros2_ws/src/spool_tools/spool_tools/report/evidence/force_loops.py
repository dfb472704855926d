"""Force over displacement and over velocity, before and after, at the measured motion."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from spool_core.uncertainty import number, percent

from spool_tools.report.drawing.palette import AFTER, BEFORE, DASHED, MEASURED, WIDTH, plain
from spool_tools.report.estimates.loops import Loops, Profile

from .exhibit import Exhibit, listed

TITLE = "Force loops"
CAPTION = (
    "Above: force that springs, oil and friction take, over displacement and over velocity, during a few "
    "periods around the largest motion: measured, and as the models say at the same motion. Below: measured "
    "less model, the force that is missing; thin: the same periods, thick with markers: median over the "
    "whole record. Good: the missing force after is a thin line around zero. Bad: it has a shape: a step at "
    "velocity 0 is dry friction, a slope over velocity drag, a slope over displacement a spring, a bend "
    "there a stiffening spring, a wall at one end a stop, an open loop a delay between the channels or "
    "friction with a memory."
)
LOOKS = ((BEFORE, DASHED, "s"), (AFTER, "-", "o"))
#: Share of the missing force's size that a step or a slope must make to be said.
WORTH_SAYING = 0.15


def force_loops(loops: Loops) -> Exhibit:
    """Return the picture of ``loops``."""
    figure, axes = plt.subplots(2, 2, figsize=(WIDTH, 6.4), layout="constrained", sharex="col", sharey="row")
    looks = dict(zip(loops.models, LOOKS[-len(loops.models) :], strict=True))
    for column, (across, label, profiles) in enumerate(
        (
            (1e3 * loops.displacement, "relative displacement, mm", loops.over_displacement),
            (loops.velocity, "relative velocity, m/s", loops.over_velocity),
        )
    ):
        upper, lower = axes[0, column], axes[1, column]
        upper.plot(across, loops.measured, color=MEASURED, lw=3.0, alpha=0.7, label="measured")
        for name, force in loops.models.items():
            colour, dash, marker = looks[name]
            upper.plot(across, force, color=colour, ls=dash, lw=1.1, label=name)
            lower.plot(across, loops.measured - force, color=colour, ls=dash, lw=0.5, alpha=0.6)
            profile = profiles[name]
            factor = 1e3 if column == 0 else 1.0
            lower.plot(factor * profile.centres, profile.force, color=colour, marker=marker, ms=3.5, lw=1.6)
        lower.axhline(0.0, color=MEASURED, lw=0.6)
        plain(upper, "", "force, N" if column == 0 else "")
        plain(lower, label, "missing force, N" if column == 0 else "")
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, fontsize=8, loc="outside lower center", ncols=3)
    return Exhibit(TITLE, figure, CAPTION, _seen(loops))


def _seen(loops: Loops) -> str:
    parts = []
    for name, missing in loops.missing.items():
        shape = _shape(loops.over_displacement[name], loops.over_velocity[name], missing)
        share = percent(missing / max(loops.force, 1e-30))
        parts.append(f"{name} {share} ({number(missing, 2)} N rms){shape}")
    text = "; ".join(parts)
    return f"Of a force of {number(loops.force, 3)} N rms there is missing at the same motion: {text}."


def _shape(over_z: Profile, over_v: Profile, missing: float) -> str:
    """Return what the medians of the missing force look like, empty where they are flat."""
    found = []
    if over_v.centres.size >= 6:
        step = step_at_zero(over_v)
        if abs(step) > WORTH_SAYING * missing:
            found.append(f"a step of {number(step, 2)} N at velocity 0")
    if over_z.centres.size >= 6:
        slope = float(np.polyfit(over_z.centres, over_z.force, 1)[0])
        reach = float(np.abs(over_z.centres).max())
        if abs(slope) * reach > WORTH_SAYING * missing:
            found.append(f"a slope of {number(slope, 2)} N/m over displacement")
    return f", with {listed(found)}" if found else ""


def step_at_zero(profile: Profile) -> float:
    """Return the step of a force at velocity 0, N: mean of the bins on both sides, the slope taken off."""
    right, left = profile.centres > 0.0, profile.centres < 0.0
    if right.sum() < 2 or left.sum() < 2:
        return 0.0
    columns = np.array([np.ones(profile.centres.size), profile.centres, np.sign(profile.centres)]).T
    return 2.0 * float(np.linalg.lstsq(columns, profile.force, rcond=None)[0][2])
