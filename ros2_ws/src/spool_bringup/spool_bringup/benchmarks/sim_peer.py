"""One of SciPy's solvers on the problem of :mod:`.sim`, in a process of its own.

LSODA writes to standard output from Fortran at each failure, and a solver that hangs has to be stopped.
Run as ``python -m spool_bringup.benchmarks.sim_peer METHOD FRICTION TOLERANCE CAP FILE``.
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]

SECONDS, RATE = 10.0, 2000.0
MASS, DRAG, STIFFNESS, FRICTION = 0.18, 2.65, 1632.0, 0.5
AMPLITUDE, LOW, HIGH = 10.0, 8.0, 110.0

#: How a solver without sets is given dry friction.
SIGNS: dict[str, Callable[[float], float]] = {
    "sgn": lambda v: math.copysign(1.0, v) if v else 0.0,
    "tanh(v/1e-4)": lambda v: math.tanh(v / 1e-4),
}


class _GaveUpError(Exception):
    """The time allowed is over."""


def solve(method: str, friction: str, tolerance: float, cap: float) -> tuple[float, Array | None]:
    """Return the time taken (s) and the displacement at the samples, m, or ``None`` without a result.

    A solver that stops with a failure is set going again from its last sample with half the largest step,
    until ``cap`` s are over.

    Args:
        method: of ``solve_ivp``.
        friction: one of ``SIGNS``.
        tolerance: relative; the absolute one is a millionth of it, in m and m/s.
        cap: s.
    """
    sign = SIGNS[friction]
    begin = time.perf_counter()
    rate = (HIGH - LOW) / SECONDS

    def slope(t: float, y: Array) -> tuple[float, float]:
        if time.perf_counter() - begin > cap:
            raise _GaveUpError
        z, v = float(y[0]), float(y[1])
        body = AMPLITUDE * math.sin(2.0 * math.pi * (LOW + 0.5 * rate * t) * t)
        return v, -body - (DRAG * v + STIFFNESS * z + FRICTION * sign(v)) / MASS

    times = np.arange(round(SECONDS * RATE)) / RATE
    found = np.zeros((times.size, 2))
    first, largest_step = 0, 0.25 / HIGH
    while True:
        try:
            part = solve_ivp(
                slope,
                (times[first], SECONDS),
                found[first],
                method=method,
                t_eval=times[first:],
                rtol=tolerance,
                atol=1e-6 * tolerance,
                max_step=largest_step,
            )
        except _GaveUpError:
            return time.perf_counter() - begin, None
        reached = len(part.t)
        if reached:
            found[first : first + reached] = np.asarray(part.y).T
        if part.success:
            return time.perf_counter() - begin, found[:, 0]
        first += max(0, reached - 1)
        largest_step = max(1e-6, 0.5 * largest_step)


def main(method: str, friction: str, tolerance: str, cap: str, file: str) -> None:
    """Solve and leave time and displacement (empty without a result) in ``file``."""
    warnings.simplefilter("ignore")
    seconds, displacement = solve(method, friction, float(tolerance), float(cap))
    with Path(file).open("wb") as output:
        np.savez(output, seconds=seconds, displacement=np.empty(0) if displacement is None else displacement)


if __name__ == "__main__":
    main(*sys.argv[1:])
