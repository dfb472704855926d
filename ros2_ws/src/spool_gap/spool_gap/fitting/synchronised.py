"""Synchronised runs, which a damper ties to the measured motion: where fits of springs with play begin.

With play or preload a spool swings in one of several ways at the same excitation, so a free run of almost the
right numbers follows the measured motion or another, at chance, and the sum of squares is full of minima. A
damper between model and measurement leaves one way, and one minimum: synchronization (Abarbanel and others,
Dynamical state and parameter estimation, SIAM Journal on Applied Dynamical Systems 8, 2009). Its force has
two parts: more viscous drag on the model, and a excitation in proportion to the measured velocity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from spool_gap.simulation.point import Point
from spool_gap.simulation.segments import Stretch
from spool_gap.simulation.shooting import Piece, pieces_of
from spool_gap.simulation.simulate import Simulation

from .descent import descend
from .hypothesis import Fitting

#: Synchronising dampers over the critical one of mass and spring, one fit after the other.
DAMPING_RATIO = 0.3
DAMPING_RATIOS = (0.6, DAMPING_RATIO)
#: Share of the samples of other fits, rounds of each fit, and starts that are followed.
SHARE, ROUNDS, TRIES = 2, 8, 2
#: Samples that a synchronised run goes on where a free one starts from it.
LOOK = 8


def holds_damper(fitting: Fitting) -> bool:
    """Whether the base has viscous drag, which the model's part of the damper is added to."""
    return any(entry.name == "viscous_friction" for entry in fitting.base.terms)


def synchronised_start(
    fitting: Fitting, whole: Sequence[Stretch], effects: tuple[str, ...], starts: Sequence[Point]
) -> Point | None:
    """Return the best of ``starts`` with the numbers of base and ``effects`` as fitted with the dampers.

    ``None`` where the base has no viscous drag that could hold the damper.
    """
    if not holds_damper(fitting):
        return None
    free = fitting.free_of(effects, starts[0])
    for number, ratio in enumerate(DAMPING_RATIOS):
        simulation = synchronised_simulation(fitting, whole, ratio, fitting.settings.longest // SHARE)
        # Far from the truth most windows are bad; counted by their logarithm they make another minimum.
        simulation = simulation.counting_robustly(robust=number > 0)
        starts = [descend(simulation, starts, free, rounds=ROUNDS, tries=TRIES, enough=1e-3).point]
    return starts[0]


def synchronised_simulation(
    fitting: Fitting, whole: Sequence[Stretch], ratio: float, longest: int
) -> Simulation:
    """Return pieces of ``whole``, synchronised with the motion as measured with gain and delay of each point.

    Args:
        fitting: gives the kernels, mass and spring.
        whole: stretches with their windows.
        ratio: of the damper over the critical one.
        longest: samples at most to fit, and again to hold out.
    """
    mass = fitting.valve.moving_mass
    damper = 2.0 * ratio * math.sqrt(fitting.valve.spring_stiffness * mass)
    pieces = pieces_of(whole, longest, *_conditioned_with(fitting), damper / mass)
    return Simulation(pieces, fitting.simulation.motions, damper)


def _conditioned_with(fitting: Fitting) -> tuple[float, float]:
    """Return the gain and delay of the spool's channel with which the motion was worked out."""
    first = next(window for stretch in fitting.stretches for window in stretch.windows)
    assert isinstance(first, Piece)
    return first.gain, first.delay


def following(fitting: Fitting, whole: Sequence[Stretch], point: Point, ratio: float) -> Simulation:
    """Return free runs over the windows of ``whole`` that start where synchronised runs of ``point`` came.

    Where the motion can go several ways, those start on the measured one, whose displacement no accelerometer
    tells within the play.
    """
    pieces = pieces_of(whole, fitting.settings.longest, *_conditioned_with(fitting))
    before = [
        replace(
            stretch,
            windows=tuple(
                replace(window, start=window.first, stop=window.first + LOOK) for window in stretch.windows
            ),
        )
        for stretch in pieces
    ]
    tied = synchronised_simulation(fitting, before, ratio, 2 * fitting.settings.longest)
    runs = iter(tied.run([point], range(len(tied.places))))
    found = []
    for stretch in pieces:
        windows = []
        for window in stretch.windows:
            run = next(runs)
            state = float(run.displacement[0, 0]), float(run.velocity[0, 0])
            assert isinstance(window, Piece)
            windows.append(replace(window, state=state, by_gain=(0.0, 0.0), by_delay=(0.0, 0.0)))
        found.append(replace(stretch, windows=tuple(windows)))
    return Simulation(found, fitting.simulation.motions)
