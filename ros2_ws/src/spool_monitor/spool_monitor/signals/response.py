"""Response of the spool to its body, with a gain between the channels that a healthy pair does not have.

    H(f) = g (w0^2 + j w d) / (w0^2 - w^2 + j w d),   w = 2 pi f

w0^2 = k/m and d = c/m (dry friction counts as the drag that takes as much energy), g the spool's sensitivity
over the body's. Fitted to cross-spectra as output error: sum of abs(S - H B)^2 over lines and windows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from spool_core.kernels.compiled import compiled

from .channel_signals import Signals
from .window import Array, Complex

#: s, time constant of forgetting of the spectra, and windows before the first fit.
MEMORY, FIRST = 2.0, 4
_STEPS = 4


@dataclass(frozen=True, slots=True)
class ValveResponse:
    """Linear response: ``natural_frequency`` (Hz), ``damping`` d (1/s), ``gain`` g with its deviation (1).

    ``misfit``: rms of what the fit leaves over that of the spool.
    """

    natural_frequency: float
    damping: float
    gain: float
    gain_deviation: float
    misfit: float

    @property
    def square(self) -> float:
        """w0^2, 1/s^2."""
        return (2.0 * math.pi * self.natural_frequency) ** 2

    def transfer(self, frequency: float) -> complex:
        """Return H without the gain at ``frequency`` (Hz)."""
        return transfer(frequency, self.square, self.damping)


@compiled
def transfer(frequency: float, square: float, damping: float) -> complex:
    """Return spool over body acceleration at ``frequency`` (Hz) for w0^2 and d, without the gain."""
    w = 2.0 * math.pi * frequency
    follows = complex(square, w * damping)
    return follows / (follows - w * w)


@dataclass(slots=True)
class ResponseTracker:
    """Response tracker: follows the response over the last few windows."""

    _weight: float = field(default=0.0, init=False)
    _body: Array = field(default_factory=lambda: np.zeros(0), init=False)
    _spool: Array = field(default_factory=lambda: np.zeros(0), init=False)
    _cross: Complex = field(default_factory=lambda: np.zeros(0, np.complex128), init=False)
    _stamp: int = field(default=0, init=False)
    _count: int = field(default=0, init=False)

    def restart(self) -> None:
        """Forget the spectra."""
        self._count = 0
        self._weight = 0.0
        self._body = np.zeros(0)

    def update(self, signals: Signals, start: ValveResponse) -> ValveResponse | None:
        """Take a window; return the fit found from ``start``, ``None`` while there are too few windows."""
        if self._body.size != signals.frequency.size:
            self.restart()
            self._body = np.zeros(signals.frequency.size)
            self._spool = np.zeros(signals.frequency.size)
            self._cross = np.zeros(signals.frequency.size, np.complex128)
            self._stamp = signals.stamp
        seconds = max(0.0, (signals.stamp - self._stamp) * 1e-9)
        self._stamp = signals.stamp
        keep = math.exp(-seconds / MEMORY)
        self._body = keep * self._body + signals.body_power
        self._spool = keep * self._spool + signals.spool_power
        self._cross = keep * self._cross + signals.cross
        self._weight = keep * self._weight + 1.0
        self._count += 1
        if self._count < FIRST:
            return None
        return self._fit(signals.frequency, start)

    def _fit(self, frequency: Array, start: ValveResponse) -> ValveResponse | None:
        body, spool = self._body, float(self._spool.sum())
        if not spool > 0.0 or not float(body.sum()) > 0.0:
            return None
        first = np.array([math.log(start.square), math.log(max(start.damping, 1e-3)), 1.0])
        theta, variance, gained = descend(frequency, body, self._cross, first)
        cost = max(spool - gained, 1e-12 * spool)
        # Windows overlap by half: about 0.6 of them are independent, each line of a Hann taper spans 1.5.
        independent = max(4.0, 0.4 * self._weight * frequency.size)
        variance *= cost / independent * max(1.0, self._weight)
        logarithmic_square, logarithmic_damping, gain = theta.tolist()
        return ValveResponse(
            natural_frequency=math.exp(0.5 * logarithmic_square) / (2.0 * math.pi),
            damping=math.exp(logarithmic_damping),
            gain=gain,
            gain_deviation=math.sqrt(max(0.0, variance)) if math.isfinite(variance) else math.inf,
            misfit=math.sqrt(cost / spool),
        )


@compiled
def descend(frequency: Array, body: Array, cross: Complex, start: Array) -> tuple[Array, float, float]:
    """Return log(w0^2), log(d) and g that fit ``cross`` = H ``body`` after some Gauss-Newton steps.

    And, at the last step, the variance of g for errors of variance 1 (infinite where nothing tells it) and
    what the fit takes off the spool's power.
    """
    theta = start.copy()
    normal, right = np.zeros((3, 3)), np.zeros(3)
    columns = np.zeros(3, np.complex128)
    gained = 0.0
    for _ in range(_STEPS):
        square, damping, gain = math.exp(theta[0]), math.exp(theta[1]), theta[2]
        normal[:] = 0.0
        right[:] = 0.0
        gained = 0.0
        for n in range(frequency.size):
            w = 2.0 * math.pi * frequency[n]
            follows = complex(square, w * damping)
            lower = follows - w * w
            inverse = lower.conjugate() * (1.0 / (lower.real**2 + lower.imag**2))
            shape = follows * inverse
            # d/d follows of follows / (follows - w^2)
            slope = -w * w * inverse * inverse
            columns[0] = gain * slope * square
            columns[1] = gain * slope * complex(0.0, w * damping)
            columns[2] = shape
            model = gain * shape
            rest = cross[n] - model * body[n]
            gained += (model.conjugate() * (cross[n] + rest)).real
            for i in range(3):
                right[i] += (columns[i].conjugate() * rest).real
                for j in range(i + 1):
                    normal[i, j] += body[n] * (columns[i].conjugate() * columns[j]).real
        for i in range(3):
            for j in range(i):
                normal[j, i] = normal[i, j]
        damped = normal + 1e-9 * np.trace(normal) * np.eye(3)
        step = np.linalg.solve(damped, right)
        for i in range(3):
            theta[i] += min(0.3, max(-0.3, step[i]))
        for i in range(2):
            theta[i] = min(25.0, max(-5.0, theta[i]))
    # The last element of the inverse of the normal matrix.
    minor = normal[0, 0] * normal[1, 1] - normal[0, 1] ** 2
    both = normal[0, 2] ** 2 * normal[1, 1] + normal[1, 2] ** 2 * normal[0, 0]
    whole = normal[2, 2] * minor - both + 2.0 * normal[0, 1] * normal[0, 2] * normal[1, 2]
    return theta, minor / whole if whole > 0.0 else math.inf, gained
