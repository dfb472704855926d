"""Node ``plots``: numbers of one valve on separate topics, and the waveform's envelope on request."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from spool_core.block import Block
from spool_core.node import qos
from spool_core.node.managed_node import ManagedNode
from spool_core.node.messages import to_block, to_time
from spool_core.node.parameters import NodeParameter
from spool_core.uncertainty import Z_95
from spool_msgs.msg import (
    AccelerationBlock,
    ModelEstimate,
    PlotValue,
    Quantity,
    ValveHealth,
    WaveformEnvelope,
)

#: Topics of one valve at most: a model has some ten numbers, and what comes over the network is data.
MOST_TOPICS = 64

Array = NDArray[np.float32]


class PlotsNode(ManagedNode):
    """Node ``plots``: publishes each known number of a valve with its interval, for live plotters."""

    PARAMETERS: ClassVar = (
        NodeParameter(
            "waveform_rate", 0.0,
            "Points a second of the envelope of both accelerations on plot/waveform; 0: none.",
            "Hz", 0.0, 1000.0, structural=True,
        ),
    )  # fmt: skip

    def __init__(self, **options: Any) -> None:
        super().__init__("plots", **options)
        self._values: dict[str, Any] = {}
        self._waveform: Any = None
        self._envelope = Envelope(1.0)

    def configure(self) -> None:
        """Make the waveform's publisher, if it is wanted; others come with the first value."""
        rate = self.value("waveform_rate")
        if rate > 0.0:
            self._envelope = Envelope(rate)
            self._waveform = self.create_lifecycle_publisher(
                WaveformEnvelope, "plot/waveform", qos.samples_offered(rate)
            )

    def activate(self) -> None:
        """Listen."""
        self.subscribe(ModelEstimate, "estimate", self._take_estimate, qos.state(depth=10))
        self.subscribe(ValveHealth, "health", self._take_health, qos.state(depth=10))
        if self._waveform is not None:
            self.subscribe(AccelerationBlock, "acceleration", self._take_block, qos.samples_wanted())

    def cleanup(self) -> None:
        """Destroy the publishers."""
        for publisher in self._values.values():
            self.destroy_publisher(publisher)
        self._values.clear()
        if self._waveform is not None:
            self.destroy_publisher(self._waveform)
            self._waveform = None

    def _take_estimate(self, message: ModelEstimate) -> None:
        own = (
            message.natural_frequency, message.damping_ratio, message.residual, message.excitation,
            message.relative_displacement, message.oil_temperature,
        )  # fmt: skip
        self._publish(message.header, (*message.parameters, *own))

    def _take_health(self, message: ValveHealth) -> None:
        drifts = (message.viscous_drift, message.coulomb_drift)
        self._publish(message.header, (message.dominant_frequency, message.amplification, *drifts))

    def _publish(self, header: Any, quantities: Iterable[Quantity]) -> None:
        """Publish what is known from current data: a plot has a gap where a number is held or unknown."""
        for one in quantities:
            if one.validity != Quantity.VALIDITY_VALID or not one.name.isidentifier():
                continue
            if one.name not in self._values:
                if len(self._values) >= MOST_TOPICS:
                    continue
                self._values[one.name] = self.create_lifecycle_publisher(
                    PlotValue, f"plot/{one.name}", qos.state(depth=10)
                )
                self._values[one.name].on_activate(None)
            half = Z_95 * one.standard_deviation if math.isfinite(one.standard_deviation) else math.nan
            message = PlotValue(value=one.value, low=one.value - half, high=one.value + half, unit=one.unit)
            message.header = header
            self._values[one.name].publish(message)

    def _take_block(self, message: AccelerationBlock) -> None:
        for point in self._envelope.update(to_block(message)):
            out = WaveformEnvelope(
                body_low=point.body[0], body_high=point.body[1],
                spool_low=point.spool[0], spool_high=point.spool[1],
            )  # fmt: skip
            out.header.stamp = to_time(point.stamp)
            out.header.frame_id = message.header.frame_id
            self._waveform.publish(out)


@dataclass(frozen=True, slots=True)
class EnvelopePoint:
    """Envelope of an interval that begins at ``stamp`` (ns): bounds of both channels, m/s^2."""

    stamp: int
    body: tuple[float, float]
    spool: tuple[float, float]


class Envelope:
    """Envelope of the blocks of one valve at a rate; keeps less than one interval of samples."""

    def __init__(self, rate: float) -> None:
        """Give ``rate`` points a second."""
        self._rate = rate
        self._body: Array = np.zeros(0, dtype=np.float32)
        self._spool: Array = np.zeros(0, dtype=np.float32)
        self._sequence = -1

    def update(self, block: Block) -> list[EnvelopePoint]:
        """Return the intervals that ``block`` completes; what a lost or malformed one cut off is left out."""
        if block.body.size != block.spool.size or not block.sample_period > 0.0:
            self._sequence = -1
            return []
        if block.sequence != self._sequence + 1:
            self._body = self._spool = np.zeros(0, dtype=np.float32)
        self._sequence = block.sequence
        width = max(1, round(1.0 / (self._rate * block.sample_period)))
        before = self._body.size
        body, spool = np.concatenate([self._body, block.body]), np.concatenate([self._spool, block.spool])
        count = body.size // width
        whole = count * width
        self._body, self._spool = body[whole:].copy(), spool[whole:].copy()
        bounds = [
            (rows.min(axis=1), rows.max(axis=1))
            for rows in (row[:whole].reshape(count, width) for row in (body, spool))
        ]
        first = block.stamp - round(1e9 * before * block.sample_period)
        return [
            EnvelopePoint(
                first + round(1e9 * number * width * block.sample_period),
                (float(bounds[0][0][number]), float(bounds[0][1][number])),
                (float(bounds[1][0][number]), float(bounds[1][1][number])),
            )
            for number in range(count)
        ]
