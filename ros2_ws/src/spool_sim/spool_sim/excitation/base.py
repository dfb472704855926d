"""Excitation: what every kind has in common."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from spool_sim.files.validation import NotNegative

Array = NDArray[np.float64]
TURN = 2.0 * math.pi


class Excitation(BaseModel, ABC):
    """Excitation: body acceleration as a pure function of time; frozen, no state.

    Attributes:
        soft_start: s over which the amplitude rises from zero at t = 0 (raised cosine); 0 for none.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    soft_start: NotNegative = 0.0

    def acceleration(self, t: Array) -> Array:
        """Return the body acceleration (m/s^2, shape of ``t``) at times ``t`` (s since the start).

        Each value depends on its own time alone, so any split of a record gives the same numbers.
        """
        t = np.asarray(t, dtype=np.float64)
        steady = self._steady(t)
        if self.soft_start > 0.0 and t.size and float(t.min()) < self.soft_start:
            steady = steady * rise(t, self.soft_start)
        return steady

    @property
    @abstractmethod
    def highest_frequency(self) -> float:
        """Highest frequency the excitation contains, Hz."""

    @abstractmethod
    def _steady(self, t: Array) -> Array:
        """Return the acceleration without the soft start."""


def rise(t: Array, duration: float) -> Array:
    """Return the raised cosine from 0 (t <= 0) to 1 (t >= duration)."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.clip(t / duration, 0.0, 1.0)))


def turns_to_sine(turns: Array) -> Array:
    """Return sin(2 pi turns); whole turns are taken off first, which keeps late times exact."""
    return np.asarray(np.sin(TURN * (turns - np.floor(turns))))


def sum_of_lines(t: Array, frequencies: Array, amplitudes: Array, phases: Array) -> Array:
    """Return the sum of sines: Hz, m/s^2 peak and turns, each of shape (lines,).

    One line after the other: the order of the sum does not depend on how many times are asked for.
    """
    total = np.zeros(t.shape)
    for frequency, amplitude, phase in zip(frequencies, amplitudes, phases, strict=True):
        total += amplitude * turns_to_sine(frequency * t + phase)
    return total
