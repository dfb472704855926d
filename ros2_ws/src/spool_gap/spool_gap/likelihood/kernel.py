"""One kernel for every structure: all terms of the catalogue compiled together, each with a switch.

A separate kernel for each structure would be compiled at its first use, for seconds each. Here a term
whose switch is 0 costs one comparison. The step is that of :mod:`spool_sim.integration.stepping`; slopes come
with :mod:`spool_gap.likelihood.slope_stepping`.
"""

from __future__ import annotations

import ast
import dis
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_sim.integration import composition
from spool_sim.integration.composed_motion import ComposedMotion, Correction, substeps_for
from spool_sim.model import Model
from spool_sim.terms import TERMS, Parameter, Term, term

from spool_gap.catalogue import EFFECTS
from spool_gap.likelihood import slope_stepping

ALWAYS = ("inertia", "spring", "viscous_friction")
#: Switch of all terms together that do more than slide, but those of ``ALWAYS``: most hypotheses have none.
PUSHING = "pushing"
#: Functions of the laws that a step calls up to dozens of times.
INNERMOST = ("smooth", "sliding", "remembered")
#: Most steps per sample that a structure may ask for; a stiffer one is stepped more coarsely.
MOST_SUBSTEPS = 8
#: Step for the slopes of a law in the motion, over the motion's typical size.
SMALL = 1e-5
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
        self._kernel = _kernel(ordered)
        self._memories = sum("memory_law" in entry.laws for entry in self.terms)

    def warm_up(self) -> None:
        """Compile what analyses use of the kernel, or load it from the disk."""
        sets, first = self.row(ALWAYS, {})[np.newaxis], np.zeros(1, dtype=np.int64)
        self.predict_batch(
            np.zeros((1, 3)), np.zeros((1, 1)), np.ones(1), sets, rows=(first, first),
            correction=Correction(0.0, 0.0, 1.0), sample_period=1e-3, substeps=1, means=False,
        )  # fmt: skip
        self.forces(np.zeros(1), np.zeros(1), sets, sample_period=1e-3)

    def predict_with_slopes(
        self,
        body_acceleration: Array,
        measured: Array,
        heard: Array,
        sets: Array,
        *,
        forced: tuple[Array, NDArray[np.int64]],
        shifted: tuple[Array, NDArray[np.int64]],
        correction: Correction,
        sample_period: float,
        substeps: int,
        means: bool,
        begin: float = 0.0,
    ) -> tuple[Array, Array, Array, Array]:
        """Predict as ``predict_batch`` does for one set, and how the errors change with u numbers.

        Args:
            body_acceleration: m/s^2, shape (2 n substeps + 1,); ``measured``, ``heard``: shape (n,).
            sets: the parameters, and these with each number but the mass changed by a small step, shape
                (1 + u, p).
            forced: changes of the body's acceleration by a number of the measuring chain, m/s^2, shape
                (r, 2 n substeps + 1), and the row of each number, -1 for none, shape (u,).
            shifted: the same for what was measured, shape (r, n) and (u,).
            correction, sample_period, substeps, means, begin: as there.

        Returns:
            Errors, displacement and velocity, shape (n,) each, and the change of the errors with each number,
            shape (u, n), over its step.
        """
        samples, count = measured.size, sets.shape[0] - 1
        step = sample_period / substeps
        mass = float(sets[0, self.columns["inertia", "mass"]])
        valve = np.zeros((count + 1, 2))
        for place, column in enumerate(
            (("spring", "spring_stiffness"), ("viscous_friction", "viscous_coefficient"))
        ):
            values = sets[:, self.columns[column]]
            valve[0, place], valve[1:, place] = values[0], (values[0] - values[1:]) / mass
        stiffness, drag = valve[0].tolist()
        linear = np.concatenate(
            [transition(mass, stiffness, drag, one).ravel() for one in (step, 0.5 * step)]
        )
        natural = math.sqrt(max(abs(stiffness), 1.0) / mass)
        speed = max(float(body_acceleration.std()), 1e-3) / natural
        found, slopes = np.empty((3, samples)), np.zeros((samples, count))
        self._kernel.predict_slopes_kernel(
            body_acceleration, measured, heard, step, substeps,
            self._packed(np.ascontiguousarray(sets, dtype=np.float64)), self._acting(sets), valve, linear,
            *forced, *shifted, SMALL * speed / natural, SMALL * speed,
            correction.displacement, correction.velocity, correction.largest, means, begin, *found, slopes,
        )  # fmt: skip
        return *found, np.ascontiguousarray(slopes.T)

    def _acting(self, sets: Array) -> tuple[NDArray[np.int64], ...]:
        """Return the numbers of the terms that act in ``sets``, as ``slope_stepping.Terms``."""
        places = {number: entry for number, entry in enumerate(self.terms) if entry.name in self.switches}
        acting = [number for number, entry in places.items() if sets[0, self.switches[entry.name]] != 0.0]
        changed = [set(np.flatnonzero(row != sets[0])) for row in sets[1:]]
        of = {
            number: {self.columns[places[number].name, one.name] for one in places[number].parameters}
            for number in acting
        }
        owners = [[number for number in acting if of[number] & columns] for columns in changed]
        table = np.full((len(owners), max(map(len, owners), default=0) + 1), -1)
        for row, numbers in zip(table, owners, strict=True):
            row[: len(numbers)] = numbers
        by_place, by_speed = (
            [number for number in acting if depends_on(places[number], names)]
            for names in (("z",), ("v", "speed"))
        )
        return *(np.array(one, dtype=np.int64) for one in (acting, by_place, by_speed)), table

    def _packed(self, parameters: Array) -> NDArray[np.void]:
        # A record goes to a function as its address; dozens of numbers by value cost more than the laws.
        return parameters.view([(f"c{place}", np.float64) for place in range(self.width)])[..., 0]

    def has(self, active: Sequence[str]) -> bool:
        """Whether all terms of ``active`` are compiled in."""
        return all(name in ALWAYS or name in self.switches for name in active)

    def has_slopes(self, active: Sequence[str]) -> bool:
        """Whether a run with the terms ``active`` gives slopes that a fit can use.

        A term that remembers has none here. After some hits at a stop a small change is anything, and
        differences over steps of some length are the better guide.
        """
        return not any(_remembers_or_hits(term(name)) for name in active)

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


@lru_cache(maxsize=64)
def depends_on(entry: Term, names: tuple[str, ...]) -> bool:
    """Whether a force of ``entry`` uses an argument of one of ``names``."""
    laws = [entry.uncompiled(law) for law in ("force_law", "sliding_law")]
    return any(one.argval in names for law in laws if law is not None for one in dis.get_instructions(law))


def transition(mass: float, stiffness: float, drag: float, period: float) -> Array:
    """Return how displacement and velocity of the linear valve follow from what they were, shape (2, 5).

    Columns: displacement, velocity, and the coefficients of the body's acceleration a + b u + d u^2, where u
    is the share of ``period`` (s) that has passed.
    """
    rates = np.zeros((5, 5))
    rates[0, 1], rates[1, :2] = period, (-period * stiffness / mass, -period * drag / mass)
    rates[1, 2], rates[2, 3], rates[3, 4] = -period, 1.0, 2.0
    return np.asarray(linalg.expm(rates)[:2])


def _remembers_or_hits(entry: Term) -> bool:
    contact = "levels_law" in entry.laws and depends_on(entry, ("v",))
    return "memory_law" in entry.laws or contact


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
    imports = ["import numpy as np", "from spool_sim.terms.base import Array"]
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
        ends = "".join(f", q.c{columns[entry.name, p.name]}" for p in entry.parameters)
        for law in entry.laws:
            imports.append(f"from {entry.laws[law].__module__} import {law} as {law}_{number}")
            kinds.add(law)
        if "force_law" in entry.laws:
            own = pushing if entry.name in switches else smooth
            own += guarded(entry, [f"total += force_law_{number}(z, v, t{ends})"])
        if "memory_law" in entry.laws:
            pushing += guarded(entry, [f"total += x[{len(memories)}]"])
            call = f"memory_law_{number}(x[{len(memories)}], slip, s{ends})"
            memories.append(f"({call} if q.c{switches[entry.name]} != 0.0 else 0.0)")
        if "sliding_law" in entry.laws:
            sliding += guarded(entry, [f"total += sliding_law_{number}(z, speed, s{ends})"])
            if "rest_law" in entry.laws:
                body = [f"low_{number}, high_{number} = rest_law_{number}(z{ends})",
                        f"low += low_{number}", f"high += high_{number}"]  # fmt: skip
            else:
                body = [f"low -= sliding_law_{number}(z, 0.0, -1.0{ends})",
                        f"high += sliding_law_{number}(z, 0.0, 1.0{ends})"]  # fmt: skip
            rest += guarded(entry, body)
        if "levels_law" in entry.laws:
            levels += guarded(
                entry,
                [
                    f"for place in levels_law_{number}({ends[2:]}):",
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
        ("term_force(number: int, z: float, v: float, t: float, s: float, q: np.void) -> float",
         [*_one_by_one(terms), "return 0.0"]),
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


def _one_by_one(terms: Sequence[Term]) -> list[str]:
    """Return lines that give the force of the term called ``number``, of those that do not remember."""
    columns, switches, _ = _places(terms)
    lines: list[str] = []
    for number, entry in enumerate(terms):
        if entry.name not in switches or "memory_law" in entry.laws:
            continue
        ends = "".join(f", q.c{columns[entry.name, p.name]}" for p in entry.parameters)
        parts = [f"force_law_{number}(z, v, t{ends})"] if "force_law" in entry.laws else []
        if "sliding_law" in entry.laws:
            parts.append(f"s * sliding_law_{number}(z, max(s * v, 0.0), s{ends})")
        lines += [f"if number == {number}:", f"    return {' + '.join(parts)}"]
    return lines


@lru_cache(maxsize=16)
def _kernel(names: tuple[str, ...]) -> ModuleType:
    stepping = composition.kernel_with(laws_source([term(name) for name in names]))
    # The slopes' kernel without what laws and stepping bring.
    text = Path(slope_stepping.__file__).read_text("utf-8")
    stand_in = next(node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef))
    own = "\n".join(text.splitlines()[stand_in.end_lineno :])
    return composition.load_kernel(f"{stepping}\n\n{own}")
