"""One kernel for every structure: all terms of the catalogue compiled together, each with a switch.

A separate kernel for each structure would be compiled at its first use, for seconds each. Here a term
whose switch is 0 costs one comparison. The step is that of :mod:`spool_sim.integration.stepping`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_sim.integration import composition
from spool_sim.integration.composed_motion import ComposedMotion, MotionState, substeps_for
from spool_sim.model import Model
from spool_sim.terms import TERMS, Parameter, Term, term

from spool_gap.catalogue import EFFECTS

ALWAYS = ("inertia", "spring", "viscous_friction")
#: Switch of all terms together that do more than slide, but those of ``ALWAYS``: most hypotheses have none.
PUSHING = "pushing"
#: Functions of the laws that a step calls up to dozens of times.
INNERMOST = ("smooth", "sliding", "remembered")
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


def steps_a_sample(point: Point, period: float, highest_frequency: float) -> int:
    """Return how many steps a sample (``period`` s) needs for the terms of ``point``."""
    # However steep a law of sliding is near rest, the reversal itself is located within the step.
    terms = [term(name) for name in dict.fromkeys((*ALWAYS, *point.terms))]
    terms = [entry for entry in terms if "sliding_law" not in entry.laws or "force_law" in entry.laws]
    values = {p.name: p.start for entry in terms for p in entry.parameters} | dict(point.values)
    if not any("levels_law" in entry.laws for entry in terms):
        period, highest_frequency = period / COARSER, highest_frequency / SMOOTHER
    try:
        return min(substeps_for(terms, values, period, highest_frequency), MOST_SUBSTEPS)
    except InputError:
        return MOST_SUBSTEPS


class SwitchableMotion(ComposedMotion):
    """Steps any subset of a list of terms.

    Attributes:
        columns: place of each term's parameter in a set, by (term, parameter).
        switches: place of each term's switch, and of the common one called ``PUSHING``.
        width: length of a set.
    """

    def __init__(self, names: Sequence[str]) -> None:
        """Write and load the kernel of the terms called ``names``; those of ``ALWAYS`` have no switch."""
        ordered = (*ALWAYS, *(name for name in names if name not in ALWAYS))
        self.terms = tuple(term(name) for name in ordered)
        self.columns, self.switches, self.width = _places(self.terms)
        self.names = tuple(f"column_{place}" for place in range(self.width))
        self.parameters = ()
        self._kernel = composition.load_kernel(composition.kernel_with(laws_source(self.terms)))
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
        # A record goes to a function as its address; dozens of numbers by value cost more than the laws.
        return parameters.view([(f"c{place}", np.float64) for place in range(self.width)])[..., 0]

    def has(self, active: Sequence[str]) -> bool:
        """Whether all terms of ``active`` are compiled in."""
        return all(name in ALWAYS or name in self.switches for name in active)

    def row(self, active: Sequence[str], values: Mapping[str, float]) -> Array:
        """Return a set with the terms ``active`` switched on, shape (width,); what is not given starts.

        Of ``ALWAYS``, which have no switch, those that are not ``active`` get zeros.
        """
        row = np.zeros(self.width)
        shared = {place for (name, _), place in self.columns.items() if name in ALWAYS}
        for entry in self.terms:
            for parameter in entry.parameters:
                given = entry.name in active and parameter.name in values
                place = self.columns[entry.name, parameter.name]
                if given:
                    row[place] = values[parameter.name]
                elif row[place] == 0.0 and (entry.name in active or place not in shared):
                    row[place] = parameter.start
        for name in active:
            if name in self.switches:
                row[self.switches[name]] = 1.0
                # Anything but sliding and holding at rest.
                if set(term(name).laws) - {"sliding_law", "rest_law"}:
                    row[self.switches[PUSHING]] = 1.0
        return row

    def places(self, active: Sequence[str], parameter: str) -> list[int]:
        """Return where the value of ``parameter`` stands in a set."""
        return sorted(
            {place for (name, own), place in self.columns.items() if own == parameter and name in active}
        )


def _places(terms: Sequence[Term]) -> tuple[dict[tuple[str, str], int], dict[str, int], int]:
    columns: dict[tuple[str, str], int] = {}
    shared: dict[Parameter, int] = {}
    width = 0
    for entry in terms:
        for parameter in entry.parameters:
            if parameter not in shared:
                shared[parameter] = width
                width += 1
            columns[entry.name, parameter.name] = shared[parameter]
    switches = {}
    for entry in terms:
        if entry.name not in ALWAYS:
            switches[entry.name] = width
            width += 1
    switches[PUSHING] = width
    return columns, switches, width + 1


def laws_source(terms: Sequence[Term]) -> str:
    """Return the Python source of the laws, as :mod:`spool_sim.integration.stepping` uses them."""
    columns, switches, _ = _places(terms)
    imports = ["import numpy as np", "from spool_core.numbers import Array"]
    smooth: list[str] = []
    pushing: list[str] = []
    sliding, rest, levels = [], [], []
    memories: list[str] = []
    kinds: set[str] = set()

    def guarded(entry: Term, lines: list[str]) -> list[str]:
        if entry.name not in switches:
            return lines
        return [f"if q.c{switches[entry.name]} != 0.0:", *(f"    {line}" for line in lines)]

    for number, entry in enumerate(terms):
        places = {p.name: f"q.c{columns[entry.name, p.name]}" for p in entry.parameters}
        call = partial(entry.call, number, places)
        imports += [entry.imported(number, law) for law in entry.laws]
        kinds |= entry.laws.keys()
        if "force_law" in entry.laws:
            own = pushing if entry.name in switches else smooth
            own += guarded(entry, [f"total += {call('force_law', 'z', 'v', 't')}"])
        if "memory_law" in entry.laws:
            pushing += guarded(entry, [f"total += x[{len(memories)}]"])
            moved = call("memory_law", f"x[{len(memories)}]", "slip", "s")
            memories.append(f"({moved} if q.c{switches[entry.name]} != 0.0 else 0.0)")
        if "sliding_law" in entry.laws:
            sliding += guarded(entry, [f"total += {call('sliding_law', 'z', 'speed', 's')}"])
            if "rest_law" in entry.laws:
                body = [f"low_{number}, high_{number} = {call('rest_law', 'z')}",
                        f"low += low_{number}", f"high += high_{number}"]  # fmt: skip
            else:
                body = [f"low -= {call('sliding_law', 'z', '0.0', '-1.0')}",
                        f"high += {call('sliding_law', 'z', '0.0', '1.0')}"]  # fmt: skip
            rest += guarded(entry, body)
        if "levels_law" in entry.laws:
            levels += guarded(
                entry,
                [
                    f"for place in {call('levels_law')}:",
                    "    if bottom < place < top and (math.isnan(level) or (place < level) != (z1 < z0)):",
                    "        level = place",
                ],
            )
    if pushing:
        smooth += [f"if q.c{switches[PUSHING]} != 0.0:", *(f"    {line}" for line in pushing)]
    skip = [f"if q.c{switches[PUSHING]} == 0.0:", "    return math.nan"] if levels else []
    memory = memories or ["x[0]"]
    kept = max(1, len(memories))
    numbers = "tuple[float, ...]"

    def tuple_of(parts: Sequence[str]) -> str:
        return ", ".join(parts) + ("," if len(parts) == 1 else "")

    functions = [
        ("given(parameters: Array, row: int) -> np.void", ["return parameters[row]"]),
        (f"start_memory(state: Array) -> {numbers}",
         [f"return ({tuple_of([f'state[{3 + place}]' for place in range(kept)])})"]),
        (f"smooth(z: float, v: float, t: float, x: {numbers}, q: np.void) -> float",
         ["total = 0.0", *smooth, "return total"]),
        ("sliding(z: float, speed: float, s: float, q: np.void) -> float",
         ["total = 0.0", *sliding, "return total"]),
        ("rest(z: float, q: np.void) -> tuple[float, float]",
         ["low, high = 0.0, 0.0", *rest, "return low, high"]),
        (f"remembered(x: {numbers}, slip: float, s: float, q: np.void) -> {numbers}",
         [f"return ({tuple_of(memory)})"]),
        ("next_level(z0: float, z1: float, q: np.void) -> float",
         [*skip, "level = math.nan", "bottom, top = min(z0, z1), max(z0, z1)", *levels, "return level"]),
    ]  # fmt: skip
    events = bool(kinds & {"sliding_law", "memory_law", "levels_law"})
    text = [
        *imports,
        "",
        f"EVENTS = {events}",
        f"MASS = 'c{columns['inertia', 'mass']}'",
        f"MEMORIES = {kept}",
    ]
    for head, body in functions:
        kind = "inlined" if head.partition("(")[0] in INNERMOST else "inner"
        text += ["", "", f"@{kind}", f"def {head}:", *(f"    {line}" for line in body)]
    return "\n".join(text) + "\n"
