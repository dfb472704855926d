"""Confidence ellipse of drag and dry friction: whether a record tells them apart."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.quantity import Quantity
from spool_core.uncertainty import Z_95, with_interval

from spool_tools.report.drawing.palette import AFTER, DARK, MEASURED, WIDTH, plain
from spool_tools.report.estimates.ellipse import Ellipse

from .exhibit import Exhibit

Array = NDArray[np.float64]

TITLE = "How well drag and dry friction are told apart"
CAPTION = (
    "Pairs of viscous coefficient and Coulomb force that the record does not contradict at 95 %, from the "
    "covariance of the fit; cross: the intervals of each number by itself. Good: a small, upright ellipse "
    "that stays clear of zero. Bad: a long one that leans to the right end down: the record only tells their "
    "sum, since the spool moved with one amplitude throughout; drive it with several."
)
VISCOUS, COULOMB = "viscous_coefficient", "coulomb_force"
#: Correlation from which one makes up for the other.
ALIKE = 0.95


def ellipse_of(parameters: tuple[Quantity, ...], names: tuple[str, ...], correlation: Array) -> Ellipse:
    """Return the ellipse of both frictions from the numbers of a fit.

    Args:
        parameters: with their standard deviations.
        names: of the rows of ``correlation``.
        correlation: shape (p, p).

    Raises:
        InputError: the fit does not tell both.
    """
    known = {quantity.name: quantity for quantity in parameters if np.isfinite(quantity.value)}
    for name in (VISCOUS, COULOMB):
        if name not in known or name not in names:
            raise InputError(
                f"the fit holds no {name.replace('_', ' ').replace('coulomb', 'Coulomb')} of its own"
            )
    places = [names.index(name) for name in (VISCOUS, COULOMB)]
    deviations = np.array([known[name].standard_deviation for name in (VISCOUS, COULOMB)])
    part = correlation[np.ix_(places, places)]
    if not (np.isfinite(part).all() and np.isfinite(deviations).all() and (deviations > 0.0).all()):
        raise InputError("the covariance of both frictions is not known")
    if abs(float(part[0, 1])) >= 1.0:
        raise InputError("both frictions are told only as one number")
    return Ellipse(
        (VISCOUS, COULOMB),
        (known[VISCOUS].unit, known[COULOMB].unit),
        np.array([known[VISCOUS].value, known[COULOMB].value]),
        part * np.outer(deviations, deviations),
    )


def confidence_ellipse(ellipse: Ellipse) -> Exhibit:
    """Return the picture of ``ellipse``."""
    figure, axis = plt.subplots(figsize=(0.62 * WIDTH, 4.2), layout="constrained")
    across, up = ellipse.outline()
    axis.fill(across, up, color=AFTER, alpha=0.2, lw=0)
    axis.plot(across, up, color=AFTER, lw=1.6, label="95 % of both together")
    c, force = ellipse.centre.tolist()
    dc, df = (Z_95 * ellipse.deviations).tolist()
    axis.errorbar(
        [c], [force], xerr=[dc], yerr=[df], color=DARK, marker="o", ms=4, lw=1.0, label="95 % of each"
    )
    if force - 3.0 * df < 0.0:
        axis.axhline(0.0, color=MEASURED, lw=0.8)
    axis.ticklabel_format(useOffset=False)
    plain(axis, f"viscous coefficient, {ellipse.units[0]}", f"Coulomb force, {ellipse.units[1]}")
    axis.legend(fontsize=8, frameon=False)
    return Exhibit(TITLE, figure, CAPTION, _seen(ellipse))


def _seen(ellipse: Ellipse) -> str:
    values = [
        with_interval(value, deviation, unit)
        for value, deviation, unit in zip(
            ellipse.centre.tolist(), ellipse.deviations.tolist(), ellipse.units, strict=True
        )
    ]
    correlation = ellipse.correlation
    told = (
        "what one gains the other loses, so neither is right by itself if the other is wrong"
        if abs(correlation) > ALIKE
        else "the record tells them apart"
    )
    without = ellipse.holds(np.array([ellipse.centre[0], 0.0]))
    zero = "; no dry friction at all lies within" if without else ""
    return (
        f"Viscous coefficient {values[0]}, Coulomb force {values[1]} (± 95 %), correlation "
        f"{correlation:+.2f}: {told}{zero}."
    )
