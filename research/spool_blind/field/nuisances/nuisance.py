"""Nuisance of a measuring chain: what it does to the reading of a channel, and how large it is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Generator = np.random.Generator

BODY, SPOOL, BOTH = "body", "spool", "both"
CHANNELS = (BODY, SPOOL)


@dataclass(frozen=True, slots=True)
class Seen:
    """What a nuisance's size is drawn in terms of.

    Attributes:
        rms, peak: of each channel's acceleration, m/s^2.
        rate: samples per second, Hz.
        duration: s.
        low, high: Hz, band of the excitation.
    """

    rms: Mapping[str, float]
    peak: Mapping[str, float]
    rate: float
    duration: float
    low: float
    high: float


@dataclass(frozen=True)
class FieldNuisance(ABC):
    """Nuisance of one or both channels. Its methods change nothing unless a class says otherwise.

    Attributes:
        id: of its kind.
        unit: of its size.
        stage: place in the chain; smaller ones come first.
        excludes: hidden effects of the sensors that it would be mistaken for: never drawn together.
        sizes: by channel, in ``unit``; only of channels that have it.
        seed: of its random numbers.
    """

    id: ClassVar[str]
    unit: ClassVar[str]
    stage: ClassVar[int]
    excludes: ClassVar[tuple[str, ...]] = ()

    sizes: Mapping[str, float]
    seed: int

    @classmethod
    @abstractmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw it."""

    @property
    def channel(self) -> str:
        """``body``, ``spool`` or ``both``."""
        return BOTH if len(self.sizes) > 1 else next(iter(self.sizes))

    @property
    def size(self) -> float:
        """The larger of both channels, by magnitude, in ``unit``."""
        return max(self.sizes.values(), key=abs)

    @property
    def may_be_named(self) -> tuple[str, ...]:
        """Names of sensor effects that say the same of the spool's channel: not wrong, and not demanded."""
        return ()

    def random(self, channel: str) -> Generator:
        """Return its random numbers for ``channel``."""
        return np.random.default_rng([self.seed, CHANNELS.index(channel)])

    def on_motion(self, channel: str, motion: Array, rate: float) -> Array:  # noqa: ARG002
        """Return the acceleration (m/s^2, ``rate`` Hz, far above the sampling) as it comes to the sampler."""
        return motion

    def instants(self, time: Array) -> Array:
        """Return when the samples of the instants ``time`` (s) are taken."""
        return time

    def on_noise(self, channel: str, noise: Array, rate: float) -> Array:  # noqa: ARG002
        """Return what is left of the sensor's white noise (m/s^2, sampled at ``rate`` Hz)."""
        return noise

    def disturbance(self, channel: str, reading: Array, rate: float) -> Array:  # noqa: ARG002
        """Return what it adds at random, m/s^2, shape of ``reading``."""
        return np.zeros(reading.size)

    def like_noise(self, channel: str, reading: Array, rate: float) -> Array:
        """Return what of it is noise to who knows everything else, m/s^2, shape of ``reading``."""
        return self.disturbance(channel, reading, rate)

    def on_reading(self, channel: str, reading: Array, time: Array) -> Array:  # noqa: ARG002
        """Return the samples (m/s^2, at ``time``, s) after it."""
        return reading

    def on_samples(self, time: Array, body: Array, spool: Array) -> tuple[Array, Array, Array]:
        """Return the record (s, m/s^2, m/s^2) as it is stored."""
        return time, body, spool


def draw_channels(
    generator: Generator, shares: tuple[float, float, float] = (0.3, 0.4, 0.3)
) -> tuple[str, ...]:
    """Draw the channels that have it: the body's, the spool's or both, with these chances."""
    found = str(generator.choice([BODY, SPOOL, BOTH], p=shares))
    return CHANNELS if found == BOTH else (found,)


def log_between(generator: Generator, low: float, high: float) -> float:
    """Draw from ``low`` to ``high``, evenly in the logarithm."""
    return float(np.exp(generator.uniform(np.log(low), np.log(high))))


def new_seed(generator: Generator) -> int:
    """Draw a seed for a nuisance's own random numbers."""
    return int(generator.integers(2**31))
