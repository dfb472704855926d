"""Motion under any composition of force terms, for one valve or many in parallel, and its steps per sample.

    m z'' + sum of the terms = -m w''

z is the spool's displacement relative to the body, w'' the body's acceleration. Dry friction is set-valued:
at rest it takes up any force between its bounds. See :mod:`spool_sim.integration.stepping` for the scheme.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.system import processors

from spool_sim.integration.composition import kernel_of, unique_parameters
from spool_sim.terms import Term

#: Valves below which another thread does not pay.
SMALLEST_SHARE = 16
#: rad that motion or forcing may turn within one step: the README's table of errors holds for it.
LARGEST_STEP_ANGLE = 0.25
#: Steps per sample beyond which parameters are wrong rather than stiff: at 2 kHz time constants below 1 us.
MOST_SUBSTEPS = 2000
#: Steps for laws of sliding at most: what falls within a sample hardly acts.
MOST_TO_SLIDE = 4
#: Range of motion (m, m/s) in which rates are looked for: the stroke of a valve this size, and its speed.
LARGEST_DISPLACEMENT = 5e-3
SPEEDS = tuple(1e-4 * 2.0**power for power in range(14))
#: Rates of forces that grow with time are taken at its start and after this time, s.
LATEST_TIME = 60.0


@dataclass(frozen=True, slots=True)
class MotionState:
    """Relative displacement (m), velocity (m/s) and direction of slip at one instant.

    ``direction`` is +1 or -1 while slipping and 0 while sticking; ``memory`` holds the force (N) of each term
    that remembers, in the order of the terms, and stays empty until there is one.
    """

    displacement: float = 0.0
    velocity: float = 0.0
    direction: float = 0.0
    memory: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Motion at n sample instants.

    Attributes:
        displacement: relative to the body, m, shape (n,).
        velocity: relative to the body, m/s, shape (n,).
        acceleration: of the spool itself (z'' + w''), m/s^2, shape (n,).
        stuck: True where the spool sticks, shape (n,).
        memory: force of each term that remembers, N, shape (n, k).
    """

    displacement: Array
    velocity: Array
    acceleration: Array
    stuck: NDArray[np.bool_]
    memory: Array


@dataclass(frozen=True, slots=True)
class Points:
    """Motion as an observation reads it.

    Attributes:
        acceleration: of the spool itself at each step, m/s^2, shape (n substeps,).
        events: place (steps), jump (m/s^2) and change of the rate (m/s^2 over a step) of each jump and kink
            of the acceleration, shape (e, 3).
        displacement, velocity: relative to the body, m, m/s, shape (n,).
    """

    acceleration: Array
    events: Array
    displacement: Array
    velocity: Array


def _body_rows(count: int, bodies: int, tables: int, stands_on: Sequence[int] | None) -> NDArray[np.int64]:
    """Return the row of the body that each of ``count`` valves stands on, shape (count,)."""
    if (stands_on is None and bodies not in (1, count)) or tables not in (1, count):
        raise ValueError(f"{count} states, but {bodies} bodies, {tables} tables")
    if stands_on is None:
        return np.arange(count) if bodies > 1 else np.zeros(count, dtype=np.int64)
    if len(stands_on) != count or not all(0 <= row < bodies for row in stands_on):
        raise ValueError(f"stands_on must name one of {bodies} bodies for each of {count} states")
    return np.array(stands_on, dtype=np.int64)


class ComposedMotion:
    """Time stepping of a list of force terms, compiled for that list.

    Attributes:
        terms: in the order of the list, with inertia among them.
        parameters: of all terms; one shared by two terms stands once.
        names: of the parameters, the columns of the arrays that ``advance`` takes.
    """

    def __init__(self, terms: Sequence[Term]) -> None:
        """Write and load the kernel of ``terms``.

        Raises:
            InputError: two terms use one parameter name for different things.
        """
        self.terms = tuple(terms)
        self.parameters = unique_parameters(self.terms)
        self.names = tuple(parameter.name for parameter in self.parameters)
        self._kernel = kernel_of(self.terms)
        self._memories = sum("memory_law" in entry.laws for entry in self.terms)

    def table(self, values: Mapping[str, float | Array], samples: int) -> Array:
        """Return the parameters as ``advance`` takes them, shape (1, p), or (samples, p) if any is an array.

        Args:
            values: by name, each a number or of shape (samples,).
            samples: how many.
        """
        columns = [np.asarray(values[name], dtype=np.float64) for name in self.names]
        if all(column.ndim == 0 for column in columns):
            return np.array([columns], dtype=np.float64)
        return np.ascontiguousarray(np.column_stack([np.broadcast_to(column, samples) for column in columns]))

    def advance(
        self,
        state: MotionState,
        body_acceleration: Array,
        table: Array,
        *,
        sample_period: float,
        substeps: int,
        first_sample: int = 0,
    ) -> tuple[Trajectory, MotionState]:
        """Advance by n samples and return the motion at their instants and the state at the next one.

        Any split of a record into calls gives the same numbers bit for bit, when the state is handed on.

        Args:
            state: at the first sample.
            body_acceleration: m/s^2, shape (2 n substeps + 1,): at the ends and the midpoints of all
                substeps, from the first sample to the one after the last.
            table: parameters, shape (1, p) or (n, p) (held from sample to sample).
            sample_period: s between samples.
            substeps: steps per sample.
            first_sample: number of the first sample since the start, for laws that depend on time.

        Raises:
            ValueError: shapes do not fit.
        """
        trajectories, states = self.advance_batch(
            [state],
            body_acceleration[np.newaxis],
            table[np.newaxis],
            sample_period=sample_period,
            substeps=substeps,
            first_sample=first_sample,
        )
        return Trajectory(*(getattr(trajectories, one.name)[0] for one in fields(Trajectory))), states[0]

    def advance_batch(
        self,
        states: Sequence[MotionState],
        body_acceleration: Array,
        tables: Array,
        *,
        sample_period: float,
        substeps: int,
        first_sample: int | Sequence[int] = 0,
        stands_on: Sequence[int] | None = None,
    ) -> tuple[Trajectory, list[MotionState]]:
        """Advance b valves in parallel, on all processors; every array of the result has b as its first axis.

        Args:
            states: of the b valves at the first sample.
            body_acceleration: shape (b, 2 n substeps + 1), or (1, ...) where all stand on one body.
            tables: parameters, shape (b, 1 or n, p), or (1, ...) where all valves are alike.
            sample_period, substeps: as in ``advance``.
            first_sample: as in ``advance``, of all or of each valve.
            stands_on: row of ``body_acceleration``, then of any number of rows, for each valve.

        Raises:
            ValueError: shapes do not fit.
        """
        count = len(states)
        samples, rest = divmod(body_acceleration.shape[1] - 1, 2 * substeps)
        if rest or samples < 1:
            raise ValueError(
                f"body_acceleration holds {body_acceleration.shape[1]} values, not 2 n {substeps} + 1"
            )
        if tables.shape[1:] not in ((1, len(self.names)), (samples, len(self.names))):
            raise ValueError(
                f"parameters have shape {tables.shape[1:]}, not (1 or {samples}, {len(self.names)})"
            )
        body_rows = _body_rows(count, body_acceleration.shape[0], tables.shape[0], stands_on)
        begins = np.broadcast_to(np.asarray(first_sample, dtype=np.int64), count).copy()
        packed = self._pack(states)
        z, v, a = (np.empty((count, samples)) for _ in range(3))
        stuck, memory = np.empty((count, samples), dtype=np.bool_), np.empty((count, samples, self._memories))
        bodies = np.ascontiguousarray(body_acceleration, dtype=np.float64)
        parameters = self._packed(np.ascontiguousarray(tables, dtype=np.float64))

        def advance_some(part: slice) -> None:
            self._kernel.advance_batch_kernel(
                packed[part],
                bodies,
                body_rows[part],
                begins[part],
                sample_period / substeps,
                substeps,
                parameters[part] if parameters.shape[0] > 1 else parameters,
                (z[part], v[part], a[part], stuck[part], memory[part]),
            )

        shares = max(1, min(processors(), count // SMALLEST_SHARE))
        edges = [count * number // shares for number in range(shares + 1)]
        parts = [slice(first, last) for first, last in pairwise(edges)]
        if len(parts) == 1:
            advance_some(parts[0])
        else:  # the kernel runs without the interpreter lock, and no valve knows of another
            with ThreadPoolExecutor(len(parts)) as pool:
                list(pool.map(advance_some, parts))
        return Trajectory(z, v, a, stuck, memory), self._unpack(packed)

    def read(
        self,
        state: MotionState,
        body_acceleration: Array,
        table: Array,
        *,
        sample_period: float,
        substeps: int,
        first_sample: int = 0,
    ) -> tuple[Points, MotionState]:
        """Return what an observation makes readings of, and the state at the sample after the last.

        Arguments and their shapes are those of ``advance``.
        """
        states = self._pack([state])
        (points,) = self._read(
            states, body_acceleration[np.newaxis], table[np.newaxis], np.zeros(1, dtype=np.int64),
            first_sample, sample_period, substeps,
        )  # fmt: skip
        return points, self._unpack(states)[0]

    def read_batch(
        self,
        state: MotionState,
        body_acceleration: Array,
        tables: Array,
        *,
        rows: NDArray[np.int64],
        sample_period: float,
        substeps: int,
        first_sample: int = 0,
    ) -> list[Points]:
        """Return what an observation makes readings of, for s parameter sets from one ``state``.

        Args:
            state: at the first sample.
            body_acceleration: m/s^2, shape (b, 2 n substeps + 1), as in ``advance``.
            tables: parameters, shape (s, 1 or n, p).
            rows: of ``body_acceleration`` for each set, shape (s,).
            sample_period, substeps, first_sample: as in ``advance``.
        """
        states = self._pack([state] * tables.shape[0])
        return self._read(states, body_acceleration, tables, rows, first_sample, sample_period, substeps)

    def _read(
        self,
        states: Array,
        body_acceleration: Array,
        tables: Array,
        rows: NDArray[np.int64],
        first_sample: int,
        sample_period: float,
        substeps: int,
    ) -> list[Points]:
        count, steps = states.shape[0], (body_acceleration.shape[1] - 1) // 2
        samples = steps // substeps
        points, z, v = (np.empty((count, size)) for size in (steps, samples, samples))
        # Where reversals come closer than this, what they add is noise.
        events, counts = np.empty((count, 2 * steps + 16, 3)), np.zeros(count, dtype=np.int64)
        self._kernel.read_batch_kernel(
            states, np.ascontiguousarray(body_acceleration), rows, first_sample, sample_period / substeps,
            substeps, self._packed(np.ascontiguousarray(tables)), (points, z, v, events), counts,
        )  # fmt: skip
        return [
            Points(points[one], events[one, : counts[one]].copy(), z[one], v[one]) for one in range(count)
        ]

    def _pack(self, states: Sequence[MotionState]) -> Array:
        packed = np.zeros((len(states), 3 + max(1, self._memories)))
        for row, state in zip(packed, states, strict=True):
            row[:3] = state.displacement, state.velocity, state.direction
            row[3 : 3 + len(state.memory)] = state.memory
        return packed

    def _unpack(self, packed: Array) -> list[MotionState]:
        return [
            MotionState(z, v, direction, tuple(memory[: self._memories]))
            for z, v, direction, *memory in packed.tolist()
        ]

    def _packed(self, parameters: Array) -> NDArray[Any]:
        return parameters

    def forces(
        self,
        displacement: Array,
        velocity: Array,
        sets: Array,
        *,
        sample_period: float,
        first_sample: int = 0,
    ) -> Array:
        """Return the force of all terms but inertia, N, shape (s, n), at given motion.

        Dry friction at velocity 0 counts as 0; terms that remember start from 0 at the first sample.

        Args:
            displacement, velocity: relative to the body, m and m/s, shape (n,).
            sets: parameters, shape (s, p).
            sample_period: s between samples.
            first_sample: number of the first sample since the start, for laws that depend on time.
        """
        out = np.empty((sets.shape[0], displacement.size))
        self._kernel.force_kernel(
            np.ascontiguousarray(displacement, dtype=np.float64),
            np.ascontiguousarray(velocity, dtype=np.float64),
            np.zeros(3 + max(1, self._memories)),
            first_sample,
            float(sample_period),
            self._packed(np.ascontiguousarray(sets, dtype=np.float64)),
            out,
        )
        return out

    def warm_up(self) -> None:
        """Compile the kernel, or load it from the disk, now instead of at the first sample."""
        table = np.array([[parameter.start for parameter in self.parameters]])
        self.advance(MotionState(), np.zeros(3), table, sample_period=1e-3, substeps=1)


def slopes(
    entry: Term, values: Mapping[str, float], largest_displacement: float = LARGEST_DISPLACEMENT
) -> tuple[float, float]:
    """Return the steepest change of a term's force with displacement (N/m) and with velocity (N s/m)."""
    given = tuple(float(values[parameter.name]) for parameter in entry.parameters)
    return _slopes(entry, given, largest_displacement)


def substeps_needed(
    sample_period: float,
    *,
    mass: float,
    viscous_coefficient: float,
    spring_stiffness: float,
    highest_frequency: float = 0.0,
) -> int:
    """Return how many steps a sample needs: the fastest rate turns at most LARGEST_STEP_ANGLE in one.

    Args:
        sample_period: s.
        mass: kg.
        viscous_coefficient: N s/m.
        spring_stiffness: N/m.
        highest_frequency: of the body acceleration, Hz.

    Raises:
        InputError: the parameters are so stiff that more than MOST_SUBSTEPS would be needed.
    """
    fastest = max(
        math.sqrt(spring_stiffness / mass), viscous_coefficient / mass, 2.0 * math.pi * highest_frequency
    )
    needed = max(1, math.ceil(fastest * sample_period / LARGEST_STEP_ANGLE))
    if needed > MOST_SUBSTEPS:
        raise InputError(
            f"sample period {sample_period:g} s needs {needed} steps a sample for a time constant of "
            f"{1.0 / fastest:g} s (at most {MOST_SUBSTEPS}); raise the rate or check mass, stiffness, damping"
        )
    return needed


def substeps_for(
    terms: Sequence[Term], values: Mapping[str, float], sample_period: float, highest_frequency: float = 0.0
) -> int:
    """Return how many steps a sample needs for the stiffest rate of ``terms``.

    Args:
        terms: with inertia among them.
        values: parameters by name.
        sample_period: s.
        highest_frequency: of the body acceleration, Hz.

    Raises:
        InputError: the parameters are so stiff that more than MOST_SUBSTEPS would be needed.
    """
    steepest = [slopes(entry, values) for entry in terms]
    return substeps_needed(
        sample_period,
        mass=values["mass"],
        viscous_coefficient=sum(damping for _, damping in steepest),
        spring_stiffness=sum(stiffness for stiffness, _ in steepest),
        highest_frequency=max(highest_frequency, values.get("force_frequency", 0.0)),
    )


def substeps_to_compare(
    terms: Sequence[Term],
    values: Mapping[str, float],
    sample_period: float,
    highest_frequency: float,
    acceleration: float,
) -> int:
    """Return how many steps a sample needs of a motion that is compared with a noisy record.

    However steep a law of sliding is near rest, the reversal itself is located within its step. After it the
    law falls, and the points must resolve that: a step passes a quarter of the speed over which it falls.

    Args:
        terms, values, sample_period, highest_frequency: as :func:`substeps_for` takes them.
        acceleration: of the spool relative to the body at reversals, m/s^2.

    Raises:
        InputError: as :func:`substeps_for`.
    """
    stepped = [entry for entry in terms if "sliding_law" not in entry.laws or "force_law" in entry.laws]
    falls = [
        values[p.name]
        for entry in terms
        for p in entry.parameters
        if "sliding_law" in entry.laws and p.name.endswith("_velocity")
    ]
    passed = 4.0 * acceleration * sample_period / min(falls, default=math.inf)
    steps = substeps_for(stepped, values, sample_period, highest_frequency)
    return max(steps, math.ceil(min(passed, MOST_TO_SLIDE)))


def half_step_times(first_sample: int, samples: int, sample_rate: float, substeps: int) -> Array:
    """Return the times (s, from sample 0) at which ``ComposedMotion.advance`` wants the body acceleration.

    Times come from whole numbers, so that neighbouring calls share their border bit for bit.
    """
    first = 2 * substeps * first_sample
    index = np.arange(first, first + 2 * substeps * samples + 1, dtype=np.int64)
    return index / (2.0 * substeps * sample_rate)


def halving_error(
    motion: ComposedMotion,
    values: Mapping[str, float],
    body_acceleration: Callable[[Array], Array],
    *,
    seconds: float,
    sample_rate: float,
    substeps: int,
) -> float:
    """Return the step error of the displacement, by halving the step: rms of the difference over rms.

    Args:
        motion: the composition.
        values: parameters by name.
        body_acceleration: function of time (s) in m/s^2.
        seconds: length of the trial.
        sample_rate: Hz.
        substeps: steps per sample of the coarser run.
    """
    samples = max(1, round(seconds * sample_rate))
    runs = []
    for count in (substeps, 2 * substeps):
        forcing = body_acceleration(half_step_times(0, samples, sample_rate, count))
        trajectory, _ = motion.advance(
            MotionState(),
            forcing,
            motion.table(values, samples),
            sample_period=1.0 / sample_rate,
            substeps=count,
        )
        runs.append(trajectory.displacement)
    scale = math.sqrt(float(np.mean(runs[1] ** 2)))
    return math.sqrt(float(np.mean((runs[0] - runs[1]) ** 2))) / scale if scale > 0.0 else 0.0


def checked_substeps(
    motion: ComposedMotion,
    values: Mapping[str, float],
    body_acceleration: Callable[[Array], Array],
    *,
    seconds: float,
    sample_rate: float,
    highest_frequency: float,
    tolerance: float = 1e-3,
    doublings: int = 3,
) -> tuple[int, float]:
    """Return the steps per sample that the stiffest rate asks for, doubled while halving changes much.

    Motion with impacts can be chaotic: then no step settles it, and the error that is left is returned.

    Args:
        motion, values, body_acceleration, seconds, sample_rate: as in ``halving_error``.
        highest_frequency: of the body acceleration, Hz.
        tolerance: of the displacement, relative rms.
        doublings: of the step count at most.

    Returns:
        Steps per sample and the error that halving shows.

    Raises:
        InputError: the parameters are so stiff that more than MOST_SUBSTEPS would be needed.
    """
    substeps = substeps_for(motion.terms, values, 1.0 / sample_rate, highest_frequency)
    for _ in range(doublings + 1):
        error = halving_error(
            motion, values, body_acceleration, seconds=seconds, sample_rate=sample_rate, substeps=substeps
        )
        if error <= tolerance or 2 * substeps > MOST_SUBSTEPS:
            break
        substeps *= 2
    return substeps, error


@lru_cache(maxsize=256)  # of many hypotheses most terms keep their numbers
def _slopes(entry: Term, given: tuple[float, ...], largest_displacement: float) -> tuple[float, float]:
    smooth, sliding, memory, levels = (
        entry.uncompiled(law) for law in ("force_law", "sliding_law", "memory_law", "levels_law")
    )
    places = np.linspace(-largest_displacement, largest_displacement, 21).tolist()
    gap = 1e-3 * largest_displacement
    reached = [0.0, places[0], places[-1]]
    if levels is not None:
        # A contact that is reached is hardly entered: what it does far inside does not count.
        kinks = levels(*given)
        places += [level + side for level in kinks for side in (-gap, gap)]
        reached = [level + 20.0 * side for level in kinks for side in (-gap, gap)]
    stiffness = damping = 0.0
    takes = entry.arguments("force_law") if smooth is not None else ()
    for t in (0.0, LATEST_TIME) if "t" in takes else (0.0,):
        if smooth is not None and "z" in takes:
            for z in places:
                ahead, behind = smooth(z + 0.5 * gap, 0.0, t, *given), smooth(z - 0.5 * gap, 0.0, t, *given)
                stiffness = max(stiffness, abs(ahead - behind) / gap)
        if smooth is not None and "v" in takes:
            for z in reached if "z" in takes else (0.0,):
                for speed in SPEEDS:
                    for side in (-1.0, 1.0):
                        change = smooth(z, 2.0 * side * speed, t, *given) - smooth(z, side * speed, t, *given)
                        damping = max(damping, abs(change) / speed)
    if sliding is not None and "speed" in entry.arguments("sliding_law"):
        for speed in SPEEDS:
            for side in (-1.0, 1.0):
                change = sliding(0.0, 2.0 * speed, side, *given) - sliding(0.0, speed, side, *given)
                damping = max(damping, abs(change) / speed)
    if memory is not None:
        # Play has no slope at rest, but at half the force.
        forces = (0.0, 0.5 * memory(0.0, 1e3, 1.0, *given))
        steepest = max(abs(memory(force, 1e-9, 1.0, *given) - force) for force in forces)
        stiffness = max(stiffness, steepest / 1e-9)
    return stiffness, damping
