"""Faults of simulated operation: what breaks, how far, how fast, and what the monitor has to call it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from spool_core.block import Block
from spool_core.numbers import Array

Channel = Literal["body", "spool"]

#: s in which a fault grows: within a moment, as by a burst of particles, over hours, over months.
SPEEDS: dict[str, tuple[float, float]] = {
    "step": (0.0, 0.0),
    "minutes": (120.0, 600.0),
    "hours": (3600.0, 7200.0),
    "months": (60.0 * 86_400.0, 180.0 * 86_400.0),
}

#: Of the first order's inertia force: dry friction beyond it locks the spool, which is another fault.
LOCKS = 0.6


@dataclass(frozen=True, slots=True)
class OperationFault:
    """Fault of a valve, a sensor or the data.

    Attributes:
        name: row of the table.
        kind, causes: of the event that has to be raised; any of the causes is right.
        speed: key of ``SPEEDS``.
        quantity: parameter that drifts, empty for others.
        size: change of the parameter when grown, relative, or N for the dry friction; of a sensor fault its
            size, see :func:`hurt`.
        matters: change of the parameter that the monitor has to find, in the same unit.
        begin, lasting: s when it begins, and in which it grows.
        channel: whose sensor it is.

    """

    name: str
    kind: str
    causes: tuple[str, ...]
    speed: str = "step"
    quantity: str = ""
    size: float = 0.0
    matters: float = 1.0
    begin: float = 0.0
    lasting: float = 0.0
    channel: Channel = "spool"

    @property
    def needs_blocks(self) -> bool:
        """Whether samples show it and estimates do not."""
        return not self.quantity

    @property
    def severity(self) -> float:
        """Size over the one that has to be found; twice that is an alarm."""
        return abs(self.size) / self.matters

    @property
    def reached(self) -> float:
        """s when the change is as large as it has to be found."""
        return self.begin + self.lasting * min(1.0, self.matters / max(abs(self.size), 1e-12))

    def grown(self, time: Array) -> Array:
        """Return how far it has grown at ``time`` (s), 0 to 1."""
        if self.lasting <= 0.0:
            return np.where(time >= self.begin, 1.0, 0.0)
        return np.clip((time - self.begin) / self.lasting, 0.0, 1.0)


WEAR = OperationFault(
    "wear", "friction_drift", ("wear",), quantity="viscous_coefficient", matters=0.2
)  # fmt: skip
CONTAMINATION = OperationFault(
    "contamination", "friction_drift", ("oil_contamination",), quantity="coulomb_force", matters=0.1
)
FATIGUE = OperationFault(
    "spring fatigue", "spring_change", ("softer",), quantity="spring_stiffness", matters=0.1
)
STICKING = OperationFault("sticking", "stuck_spool", ("",))

#: Faults of sensors and data: the right causes by the event's kind.
SENSORS: dict[str, tuple[str, tuple[str, ...]]] = {
    "dead": ("sensor_fault", ("dead",)),
    "clipping": ("sensor_fault", ("clipping",)),
    "offset": ("sensor_fault", ("offset",)),
    "swapped": ("sensor_fault", ("swapped",)),
    # A gain that jumps is seen by its jump, or once it lasts by the ratio of the sensitivities.
    "scale": ("sensor_fault", ("scale", "sensitivity")),
    "same_channel": ("sensor_fault", ("same_channel",)),
    "wrap_around": ("sensor_fault", ("wrap_around",)),
    "ac_coupling": ("sensor_fault", ("ac_coupling",)),
    "outliers": ("data_fault", ("outliers",)),
    "repeats": ("data_fault", ("repeats",)),
    "clock_step": ("data_fault", ("clock_step",)),
}


def draw_fault(draw: np.random.Generator, coulomb: float, force: float) -> OperationFault:
    """Return a fault at time 0 of a valve with ``coulomb`` N of dry friction and ``force`` N of inertia."""
    kind = draw.choice(
        ["wear", "contamination", "fatigue", "sticking", "sensor"], p=[0.3, 0.25, 0.25, 0.05, 0.15]
    )
    if kind == "sticking":
        return STICKING
    if kind == "sensor":
        return _sensor(draw)
    speed = str(draw.choice(list(SPEEDS)))
    lasting = float(draw.uniform(*SPEEDS[speed]))
    if kind == "wear":
        return replace(WEAR, speed=speed, lasting=lasting, size=-float(draw.uniform(0.2, 0.6)))
    if kind == "fatigue":
        return replace(FATIGUE, speed=speed, lasting=lasting, size=-float(draw.uniform(0.1, 0.35)))
    room = max(0.12, LOCKS * force - coulomb)
    size = min(float(draw.uniform(0.1, 0.4)), room)
    return replace(CONTAMINATION, speed=speed, lasting=lasting, size=size)


def _sensor(draw: np.random.Generator) -> OperationFault:
    name = str(draw.choice(list(SENSORS)))
    kind, causes = SENSORS[name]
    channel: Channel = "body" if draw.random() < 0.5 else "spool"
    size = {
        "dead": float(draw.choice([0.0, 0.02, 0.08])),
        "clipping": float(draw.uniform(0.6, 1.2)),
        "offset": float(draw.choice([-1.0, 1.0]) * draw.uniform(1.0, 6.0)),
        "scale": float(1.0 + draw.choice([-1.0, 1.0]) * draw.uniform(0.2, 0.5)),
        "wrap_around": float(draw.uniform(0.7, 1.1)),
        "ac_coupling": float(draw.uniform(2.0, 6.0)),
        "clock_step": float(draw.uniform(0.004, 0.02)),
    }.get(name, 0.0)
    return OperationFault(f"sensor: {name}", kind, causes, size=size, channel=channel)


class Hurt:
    """What a fault makes of blocks, one by one; ``level`` is the healthy rms of its channel, m/s^2."""

    def __init__(self, fault: OperationFault, noise: float, seed: int) -> None:
        self.fault = fault
        self.level = 0.0
        self._noise, self._draw = noise, np.random.default_rng([seed, 29])
        self._state = np.zeros(2)
        self._last: Array = np.zeros(0)

    def __call__(self, block: Block, time: float) -> Block:
        """Return ``block``, which begins at ``time`` (s)."""
        fault, name = self.fault, self.fault.name.removeprefix("sensor: ")
        samples = np.asarray(getattr(block, fault.channel), dtype=float)
        if time < fault.begin:
            self.level = max(self.level, float(samples.std()))
            self._last = samples
            return block
        other = block.spool if fault.channel == "body" else block.body
        span = fault.size * self.level * np.sqrt(2.0)
        made: dict[str, Callable[[], Array]] = {
            "sticking": lambda: block.body + self._noise * self._draw.standard_normal(block.body.size),
            "dead": lambda: fault.size * self._draw.standard_normal(samples.size),
            "clipping": lambda: np.clip(samples, -fault.size * self.level, fault.size * self.level),
            "offset": lambda: samples + fault.size,
            "scale": lambda: samples * fault.size,
            "same_channel": lambda: np.asarray(other, dtype=float),
            "wrap_around": lambda: (samples + span) % (2.0 * span) - span,
            "ac_coupling": lambda: self._high_passed(samples, block.sample_period),
            "outliers": lambda: self._spiked(samples),
            "repeats": lambda: np.repeat(samples[::2], 2)[: samples.size],
            "clock_step": lambda: self._late(samples, block.sample_period),
        }
        if name == "swapped":
            return replace(block, body=block.spool, spool=block.body)
        changed = made[name]().astype(np.float32)
        if fault.channel == "body" and name != "sticking":
            return replace(block, body=changed)
        return replace(block, spool=changed)

    def _high_passed(self, samples: Array, period: float) -> Array:
        from scipy.signal import butter, lfilter  # noqa: PLC0415 - slow to load

        b, a = butter(1, self.fault.size * 2.0 * period, "high")
        filtered, self._state = lfilter(b, a, samples, zi=self._state[:1])
        return np.asarray(filtered)

    def _spiked(self, samples: Array) -> Array:
        spiked = samples.copy()
        if self._draw.random() < 0.1:
            spiked[int(self._draw.integers(samples.size))] += 60.0 * max(self.level, 10.0)
        return spiked

    def _late(self, samples: Array, period: float) -> Array:
        late = max(1, round(self.fault.size / period))
        joined = np.concatenate([self._last, samples])
        if joined.size < samples.size + late:
            joined = np.concatenate([np.zeros(samples.size + late - joined.size), joined])
        self._last = joined[-max(late, 1) - samples.size :]
        return joined[joined.size - samples.size - late : joined.size - late]
