"""One kernel for every structure: all terms of the catalogue compiled together, each with a switch.

A separate kernel for each structure would be compiled at its first use, for seconds each. Here a term
whose switch is 0 costs one comparison. The step is that of :mod:`spool_sim.integration.stepping`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_sim.integration.composed_motion import ComposedMotion, MotionState, substeps_to_compare
from spool_sim.integration.composition import Switches, kernel_source, load_kernel
from spool_sim.model import Model
from spool_sim.terms import TERMS, term

from spool_gap.catalogue import EFFECTS

ALWAYS = ("inertia", "spring", "viscous_friction")
#: Most steps per sample that a structure may ask for; a stiffer one is stepped more coarsely.
MOST_SUBSTEPS = 8
#: How much longer a step may be than the simulator's where no force has kinks, and how much longer still as
#: to the excitation: a fit compares with noise, so an error of 1e-4 of the signal will do.
COARSER, SMOOTHER = 2.0, 1.7


def motions_for(base: Model) -> list[SwitchableMotion]:
    """Return the kernels for ``base`` with any effect: one for forces without events, and one for all.

    The effects come first, so that bases whose terms are among them have the same kernels.
    """
    wanted = [name for entry in EFFECTS.values() for name in entry.terms]
    wanted += [entry.name for entry in base.terms]
    known = tuple(dict.fromkeys(name for name in wanted if name in TERMS))
    smooth = [name for name in known if set(term(name).laws) <= {"force_law"}]
    return [SwitchableMotion(smooth), SwitchableMotion(known)]


@dataclass(frozen=True, slots=True)
class Point:
    """Force terms that are on, and their numbers."""

    terms: tuple[str, ...]
    values: Mapping[str, float]


def steps_a_sample(point: Point, period: float, highest_frequency: float, acceleration: float = 0.0) -> int:
    """Return how many steps a sample (``period`` s) needs for the terms of ``point``.

    ``highest_frequency`` (Hz) and ``acceleration`` (m/s^2) as ``substeps_to_compare`` takes them.
    """
    terms = [term(name) for name in dict.fromkeys((*ALWAYS, *point.terms))]
    values = {p.name: p.start for entry in terms for p in entry.parameters} | dict(point.values)
    coarser, smoother = (
        (1.0, 1.0) if any("levels_law" in entry.laws for entry in terms) else (COARSER, SMOOTHER)
    )
    rates = (period / coarser, highest_frequency / smoother, acceleration * coarser)
    try:
        return min(substeps_to_compare(terms, values, *rates), MOST_SUBSTEPS)
    except InputError:
        return MOST_SUBSTEPS


class SwitchableMotion(ComposedMotion):
    """Steps any subset of a list of terms."""

    def __init__(self, names: Sequence[str]) -> None:
        """Write and load the kernel of the terms called ``names``; those of ``ALWAYS`` have no switch."""
        ordered = (*ALWAYS, *(name for name in names if name not in ALWAYS))
        self.terms = tuple(term(name) for name in ordered)
        self._switches = Switches.of(self.terms, ALWAYS)
        self.names = tuple(f"c{place}" for place in range(self._switches.pushing + 1))
        self.parameters = ()
        self._kernel = load_kernel(kernel_source(self.terms, self._switches))
        self._memories = sum("memory_law" in entry.laws for entry in self.terms)

    def warm_up(self) -> None:
        """Compile what analyses use of the kernel, or load it from the disk."""
        sets = self.row(ALWAYS, {})[np.newaxis]
        self.read_batch(
            MotionState(0.0, 0.0, 0.0), np.zeros((1, 3)), sets[:, np.newaxis],
            rows=np.zeros(1, dtype=np.int64), sample_period=1e-3, substeps=1,
        )  # fmt: skip
        self.forces(np.zeros(1), np.zeros(1), sets, sample_period=1e-3)

    def _packed(self, parameters: Array) -> NDArray[np.void]:
        return parameters.view([(name, np.float64) for name in self.names])[..., 0]

    def has(self, active: Sequence[str]) -> bool:
        """Whether all terms of ``active`` are compiled in."""
        return all(name in ALWAYS or name in self._switches.terms for name in active)

    def row(self, active: Sequence[str], values: Mapping[str, float]) -> Array:
        """Return a set with the terms ``active`` switched on, shape (width,); what is not given starts.

        Of ``ALWAYS``, which have no switch, those that are not ``active`` get zeros.
        """
        row = np.zeros(len(self.names))
        shared = {place for (name, _), place in self._switches.columns.items() if name in ALWAYS}
        for entry in self.terms:
            for parameter in entry.parameters:
                given = entry.name in active and parameter.name in values
                place = self._switches.columns[entry.name, parameter.name]
                if given:
                    row[place] = values[parameter.name]
                elif row[place] == 0.0 and (entry.name in active or place not in shared):
                    row[place] = parameter.start
        for name in active:
            if name in self._switches.terms:
                row[self._switches.terms[name]] = 1.0
                # Anything but sliding and holding at rest.
                if set(term(name).laws) - {"sliding_law", "rest_law"}:
                    row[self._switches.pushing] = 1.0
        return row

    def places(self, active: Sequence[str], parameter: str) -> list[int]:
        """Return where the value of ``parameter`` stands in a set."""
        columns = self._switches.columns.items()
        return sorted({place for (name, own), place in columns if own == parameter and name in active})
