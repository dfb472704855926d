"""The response of the spool to its body, with a gain between the channels that a healthy pair does not have.

    H(f) = g (w0^2 + j w d) / (w0^2 - w^2 + j w d),   w = 2 pi f

w0^2 = k/m and d = c/m (dry friction counts as the drag that takes as much energy), g the spool's sensitivity
over the body's. Fitted to cross-spectra as output error: sum of abs(S - H B)^2 over lines and windows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .signals import Signals

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: s, time constant of forgetting of the spectra, and windows before the first fit.
MEMORY, FIRST = 2.0, 4
_STEPS = 4


@dataclass(frozen=True, slots=True)
class Response:
    """``natural_frequency`` in Hz, ``damping`` d in 1/s, ``gain`` g with its standard deviation, 1.

    ``misfit``: rms of what the fit leaves over that of the spool.
    """

    natural_frequency: float
    damping: float
    gain: float
    gain_deviation: float
    misfit: float

    def transfer(self, frequency: Array) -> Complex:
        """Return H without the gain at ``frequency`` (Hz), shape of it."""
        return transfer(frequency, (2.0 * math.pi * self.natural_frequency) ** 2, self.damping)


def transfer(frequency: Array, square: float, damping: float) -> Complex:
    """Return spool over body acceleration at ``frequency`` (Hz) for w0^2 and d."""
    w = 2.0 * math.pi * frequency
    follows = square + 1j * w * damping
    return np.asarray(follows / (follows - w**2))


@dataclass(slots=True)
class ResponseTracker:
    """Follow the response over the last few windows."""

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

    def update(self, signals: Signals, start: Response) -> Response | None:
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

    def _fit(self, frequency: Array, start: Response) -> Response | None:
        square = (2.0 * math.pi * start.natural_frequency) ** 2
        theta = np.array([math.log(square), math.log(max(start.damping, 1e-3)), 1.0])
        w = 2.0 * math.pi * frequency
        body, cross, spool = self._body, self._cross, float(self._spool.sum())
        if not spool > 0.0 or not float(body.sum()) > 0.0:
            return None
        cost = math.inf
        normal = np.eye(3)
        for _ in range(_STEPS):
            square, damping = math.exp(theta[0]), math.exp(theta[1])
            follows = square + 1j * w * damping
            lower = follows - w**2
            shape = follows / lower
            # d/d follows of follows / (follows - w^2)
            slope = -(w**2) / lower**2
            columns = np.stack((theta[2] * slope * square, theta[2] * slope * 1j * w * damping, shape))
            normal = np.real((columns.conj() * body) @ columns.T)
            model = theta[2] * shape
            right = np.real(columns.conj() @ (cross - model * body))
            cost = spool - float(np.sum(2.0 * np.real(model.conj() * cross) - np.abs(model) ** 2 * body))
            damped = normal + 1e-9 * np.trace(normal) * np.eye(3)
            theta = theta + np.clip(np.linalg.solve(damped, right), -0.3, 0.3)
            theta[:2] = np.clip(theta[:2], -5.0, 25.0)
        square, damping, gain = math.exp(theta[0]), math.exp(theta[1]), float(theta[2])
        cost = max(cost, 1e-12 * spool)
        # Windows overlap by half: about 0.6 of them are independent, each line of a Hann taper spans 1.5.
        independent = max(4.0, 0.4 * self._weight * frequency.size)
        scale = cost / independent * max(1.0, self._weight)
        try:
            variance = float(np.linalg.inv(normal)[2, 2]) * scale
        except np.linalg.LinAlgError:
            variance = math.inf
        return Response(
            natural_frequency=math.sqrt(square) / (2.0 * math.pi),
            damping=damping,
            gain=gain,
            gain_deviation=math.sqrt(max(0.0, variance)) if math.isfinite(variance) else math.inf,
            misfit=math.sqrt(cost / spool),
        )
