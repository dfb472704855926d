"""Sensor faults: channels that are dead, clip, have moved offset, scale, or are swapped."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array, Complex
from spool_core.record_limits import LIMITS
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate, State

from spool_monitor.channels import GAIN_LASTS, KEPT, MEMORY, Channel, Signals, ValveResponse, transfer
from spool_monitor.detectors.base import (
    MINIMUM_BODY,
    Detector,
    Judgement,
    Moment,
    MonitorLimit,
    MonitorSettings,
)
from spool_monitor.event import EACH_CHANNEL, EventCause, Facts, Finding, Severity, sensor_fault

CLIPPING_KIND = sensor_fault(EventCause("clipping", 602))

#: Windows that are looked back on, and how many of them must show a flat top.
WINDOWS, FLAT = 6, 3

DEAD_KIND = sensor_fault(EventCause("dead", 601))

#: Share of what is due below which a channel is dead, and above which it lives: chosen, with hysteresis.
DEAD, ALIVE = 0.12, 0.25

#: Response below which a line of the spool says nothing of the body, and share of the reference damping
#: from which both channels have something in common: then neither is dead.
FOLLOWS, COMMON = 0.3, 0.4

#: Share of what is due below which a channel is dead although it follows the other one: so much crosses over
#: between the cables of two channels.
DEAF = 0.04

#: s without a change from which a channel stands still, and from which it is suspicious; with the delay of
#: the condition and a look every half second the fault is raised 1.25 s to 1.75 s after the last change.
STANDS, SUSPICIOUS = 0.25, 0.05

#: m/s^2, step of a converter from which a machine at rest may show no noise at all: accelerometers for
#: machines have 0.002 to 0.05 m/s^2 rms of it. Steps by which such a reading may swing before it stands: more
#: is no vibration that dies away.
COARSE, SWINGS = 0.005, 3.0

OFFSET_KIND = sensor_fault(EventCause("offset", 603))

OFFSET_CHANGE = MonitorLimit("offset_change", 0.5, "Change of a channel's mean.", "m/s^2", 0.01, 1e3)

#: Windows that the mean is smoothed over: chosen, more scatter less and tell later.
SMOOTHING = 4.0

SCALE_KIND = sensor_fault(EventCause("scale", 605))

GAIN_CHANGE = MonitorLimit("gain_change", 0.1, "Relative change of a channel's gain.", "1", 0.02, 1.0)

#: What the estimator's model leaves unexplained on top of the reference: least share, and over the reference
#: share, from which no valve explains the channels any more.
UNEXPLAINED, TIMES_REFERENCE = 0.07, 2.5

#: It jumps there from less than this share of it within two estimates: a valve that changes faster than the
#: estimator follows leaves more and more. One that jumps itself is explained again by the second in a row.
BEFORE, IN_A_ROW = 0.35, 2

#: Estimates in a row without any model, after there was one, that show the same.
LOST = 4

#: Windows or estimates over which the reference is followed, and the slow pace where the gain moved.
FOLLOWED, SLOWLY = 20.0, 100.0

#: Standard deviation of the gain above which it says nothing.
IMPRECISE = 0.3

#: Relative distance from the natural frequency that counts as near, shares of the body's and the spool's
#: power there from which the machine shakes the valve at resonance, and s for which that bends the response.
NEAR, SHAKEN, ANSWERED, BENT = 0.17, 0.1, 0.5, 4.0 * MEMORY

#: Of the misfit of the linear response, what a gain may explain, and share of the limit that is suspicious.
MISFIT, SCALE_SUSPICIOUS = 0.15, 0.6

SWAPPED_KIND = sensor_fault(EventCause("swapped", 604))

#: Damping against the reference below which the channels are exchanged, and above which they are not.
NEGATIVE, POSITIVE = -0.3, 0.0


class SensorClipping(Detector):
    """Look for flat tops in each window; a machine does not clip at every moment."""

    name = "sensor_clipping"
    kind = CLIPPING_KIND
    looks_at = ("signals",)
    parts = EACH_CHANNEL
    rank = 1
    off_delay: ClassVar[float] = 15.0

    def __init__(self, settings: MonitorSettings) -> None:
        super().__init__(settings)
        self._flat: dict[str, deque[float]] = {name: deque(maxlen=WINDOWS) for name in self.parts}

    def update(self, moment: Moment) -> tuple[Finding, ...]:
        """Judge the window of ``moment``, if there is a new one."""
        if moment.signals is None:
            return ()
        self.judgement, self.suspicious = Judgement.NOT_EXCITED, ""
        channels = _channels(moment.signals)
        return tuple(self._judge(moment.stamp, name, channel) for name, channel in channels.items())

    def _judge(self, stamp: int, name: str, channel: Channel) -> Finding:
        loud = channel.rms >= self.settings[MINIMUM_BODY]
        self._flat[name].append(channel.flat_top if loud else 0.0)
        flat = [value for value in self._flat[name] if value > 0.0]
        self.judgement = Judgement.JUDGED if loud else self.judgement
        self.suspicious = f"the {name} accelerometer clips" if flat else self.suspicious
        flatness = Quantity("flat_share", "1", flat[-1] if flat else 0.0, validity=Validity.VALID)
        return Finding(
            stamp,
            Severity.ALARM if len(flat) >= FLAT else None,
            not flat,
            "clipping",
            flatness,
            lambda: Facts.of(flatness, LIMITS.clipped, name),
            part=name,
        )

    def restart(self) -> None:
        """Forget the windows before a gap."""
        super().restart()
        for flat in self._flat.values():
            flat.clear()


class SensorDead(Detector):
    """Samples that do not change, or a level far below what the other channel makes due.

    A machine at rest behind a coarse converter shows no change either: there a channel must have stopped in
    the midst of a motion.
    """

    name = "sensor_dead"
    kind = DEAD_KIND
    looks_at = ("signals",)
    parts = EACH_CHANNEL
    rank = 0
    on_delay: ClassVar[float] = 1.0

    def __init__(self, settings: MonitorSettings) -> None:
        super().__init__(settings)
        self._steps = {"body": math.nan, "spool": math.nan}
        self._stopped = {"body": True, "spool": True}
        self._stood = {"body": False, "spool": False}

    def update(self, moment: Moment) -> tuple[Finding, ...]:
        """Judge the window of ``moment``, if there is a new one."""
        signals = moment.signals
        if signals is None:
            return ()
        # The channels that stand still and should not.
        found = []
        for name, channel in _channels(signals).items():
            self._steps[name] = float(np.fmin(self._steps[name], channel.step))
            coarse = self._steps[name] >= COARSE
            if channel.standing == 0.0:
                self._stopped[name] = True
            elif not math.isnan(channel.before):
                self._stopped[name] = channel.before > SWINGS * self._steps[name]
            if channel.standing >= SUSPICIOUS and (self._stopped[name] or not coarse):
                found.append(name)
        compared = self._compare(moment, signals, known=not found)
        if found:
            self.judgement = Judgement.JUDGED
            verb = "repeat" if len(found) == 2 else "repeats"
            self.suspicious = f"the {' and the '.join(found)} accelerometer {verb} one value"
        standing = {name: self._stand(moment.stamp, name, _channels(signals)[name]) for name in found}
        return tuple(standing.get(name) or compared[name] for name in self.parts)

    def _stand(self, stamp: int, name: str, channel: Channel) -> Finding:
        seconds = channel.standing
        self._stood[name] = self._stood[name] or seconds >= STANDS
        level = Quantity("channel_level", "1", 0.0, validity=Validity.VALID)

        def facts() -> Facts:
            mean = Quantity(f"{name}_mean", "m/s^2", channel.mean, validity=Validity.VALID)
            unchanged = Quantity("unchanged_time", "s", seconds, validity=Validity.VALID)
            return replace(Facts.of(level, DEAD, name), evidence=(unchanged, mean))

        dead = Severity.ALARM if seconds >= STANDS else None
        return Finding(stamp, dead, False, "dead", level, facts, part=name)

    def _compare(self, moment: Moment, signals: Signals, *, known: bool) -> dict[str, Finding]:
        """Compare each channel's level with what the response makes of the other, if both are ``known``."""
        reference = moment.reference
        shares: dict[str, float] = {}
        due = seen = dict.fromkeys(self.parts, math.nan)
        if known and moment.described and not moment.distrust:
            due_spool, due_body, seen_body, common = due_powers(
                signals.frequency,
                signals.body_power,
                signals.spool_power,
                signals.cross,
                reference.square,
                reference.damping,
            )
            due = {"spool": math.sqrt(due_spool), "body": math.sqrt(due_body)}
            seen = {
                "spool": 0.0 if signals.spool.constant else math.sqrt(signals.spool_total),
                "body": 0.0 if signals.body.constant else math.sqrt(seen_body),
            }
            shares = {
                name: seen[name] / due[name] for name in due if due[name] >= self.settings[MINIMUM_BODY]
            }
            # A channel that follows the other, however little it shows, has a wrong sensitivity.
            follows = common > LIMITS.coherent and min(shares.values(), default=0.0) > DEAF
            if follows or abs(signals.dissipation) > COMMON * reference.damping:
                shares = dict.fromkeys(shares, 1.0)
        self.judgement = Judgement.JUDGED if shares else Judgement.NOT_EXCITED
        if moment.distrust or not moment.described:
            self.judgement = Judgement.NOT_JUDGED
        self.suspicious = ""
        return {name: self._level(moment.stamp, name, shares, (seen[name], due[name])) for name in self.parts}

    def _level(self, stamp: int, name: str, shares: dict[str, float], sizes: tuple[float, float]) -> Finding:
        share = shares.get(name, math.nan)
        dead = share < DEAD
        self._stood[name] = self._stood[name] and not dead
        if share < ALIVE:
            self.suspicious = f"the {name} accelerometer shows almost no signal"
        level = Quantity(
            "channel_level", "1", share, validity=Validity.VALID if name in shares else Validity.UNKNOWN
        )

        def facts() -> Facts:
            if name not in shares:
                return Facts(note="changes_again")
            further = zip(("shown_acceleration", "expected_acceleration"), sizes, strict=True)
            evidence = tuple(Quantity(key, "m/s^2", one, validity=Validity.VALID) for key, one in further)
            return replace(Facts.of(level, DEAD, name), evidence=evidence)

        over = share > ALIVE if name in shares else self._stood[name]
        return Finding(stamp, Severity.ALARM if dead else None, over, "dead", level, facts, part=name)


@compiled
def due_powers(
    frequency: Array, body: Array, spool: Array, cross: Complex, square: float, damping: float
) -> tuple[float, float, float, float]:
    """Return what the reference response makes of the powers per line: due of the spool and of the body.

    And the body's as seen where the spool follows; elsewhere the spool's noise says nothing of the body. The
    last one is the squared coherence of the spool with what is due of it, over all lines.
    """
    due_spool = due_body = seen_body = seen_spool = 0.0
    together = 0.0j
    for i in range(frequency.size):
        response = transfer(frequency[i], square, damping)
        power = abs(response) ** 2
        together += cross[i] * response.conjugate()
        seen_spool += spool[i]
        due_spool += body[i] * power
        if power > FOLLOWS**2:
            due_body += spool[i] / power
            seen_body += body[i]
    both = due_spool * seen_spool
    return due_spool, due_body, seen_body, abs(together) ** 2 / both if both > 0.0 else 0.0


class SensorOffset(Detector):
    """The difference of the channels' means against what it was; a tilt moves both alike."""

    name = "sensor_offset"
    kind = OFFSET_KIND
    looks_at = ("signals",)
    parts = EACH_CHANNEL
    rank = 2
    learns: ClassVar[Mapping[str, str]] = {"body_mean": "m/s^2", "spool_mean": "m/s^2"}
    on_delay: ClassVar[float] = 3.0

    def __init__(self, settings: MonitorSettings) -> None:
        super().__init__(settings)
        self._means = {"body": math.nan, "spool": math.nan}

    def update(self, moment: Moment) -> tuple[Finding, ...]:
        """Judge the window of ``moment``, if there is a new one."""
        signals = moment.signals
        if signals is None:
            return ()
        if moment.distrust:
            self.judgement = Judgement.NOT_JUDGED
            return ()
        for name, channel in _channels(signals).items():
            old = self._means[name]
            self._means[name] = channel.mean if math.isnan(old) else old + (channel.mean - old) / SMOOTHING
        starts = {name: moment.learned[f"{name}_mean"] for name in self._means}
        if not all(start.frozen for start in starts.values()):
            for name, start in starts.items():
                start.learn(moment.stamp, self._means[name])
            self.judgement = Judgement.LEARNING
            return ()
        self.judgement = Judgement.JUDGED
        moved = {name: self._means[name] - starts[name].value for name in starts}
        spread = math.hypot(*(start.spread for start in starts.values()))
        # What both means moved alike is a tilt; the rest is the channel's that moved farther.
        body, spool = moved["body"], moved["spool"]
        tilt = 0.0 if body * spool < 0.0 else min(body, spool, key=abs)
        return tuple(self._judge(moment.stamp, name, moved[name], tilt, spread) for name in self.parts)

    def _judge(self, stamp: int, name: str, moved: float, tilt: float, spread: float) -> Finding:
        limit, apart = max(self.settings[OFFSET_CHANGE], 8.0 * spread), abs(moved - tilt)
        offset = Quantity("offset_change", "m/s^2", moved, spread, Validity.VALID)

        def facts() -> Facts:
            mean = Quantity(f"{name}_mean", "m/s^2", self._means[name], validity=Validity.VALID)
            own = Facts.of(offset, math.copysign(limit, moved), name)
            return replace(own, evidence=(mean,))

        # An offset lasts while its channel stays away: the other one that follows is no repair.
        severity = Severity.WARNING if apart >= limit else None
        over = apart < 0.6 * limit and abs(moved) < limit
        return Finding(stamp, severity, over, "offset", offset, facts, part=name)

    def restart(self) -> None:
        """Begin the smoothing again."""
        super().restart()
        self._means = dict.fromkeys(self._means, math.nan)


class SensorScale(Detector):
    """The gain that the response needs besides stiffness and damping, against what it was.

    A change of the gain alone proves nothing: dry friction and the machine's speed bend a linear response.
    But where stiffness, damping and dry friction can't explain the channels any more either, it does. Above
    resonance, where a gain passes for another spring, this needs some vibration below it.
    """

    name = "sensor_scale"
    kind = SCALE_KIND
    needs_valve = True
    looks_at = ("signals", "estimate", "channels")
    rank = 4
    learns: ClassVar[Mapping[str, str]] = {"channel_gain": "1", "gain_bend": "1", "gain_frequency": "Hz"}
    on_delay: ClassVar[float] = 2.0
    stays: ClassVar[bool] = True
    _found: bool

    def __init__(self, settings: MonitorSettings) -> None:
        super().__init__(settings)
        self.relearn()
        self._near = self._changed = self._proven = -(10**18)
        self._slow = 10**18

    def update(self, moment: Moment) -> Finding | None:
        """Judge the response of ``moment``, if there is a new one; take note of an estimate's residual."""
        pair = None if moment.channels is None else moment.channels.pair
        if pair is not None and pair.changed and not moment.distrust:
            self._changed = moment.stamp
            # What was proven before does not end by a change of the valve.
            self._found = self._found and not self._explained(self._proven)
        if moment.distrust:
            self._unexplained = self._lost = 0
            if moment.signals is not None:
                self.judgement, self.suspicious = Judgement.NOT_JUDGED, ""
                self._take_gain(moment, None)
            return None
        if moment.estimate is not None:
            self._compare(moment.estimate)
        if moment.signals is None:
            return None
        shaken = moment.signals.body.rms >= self.settings[MINIMUM_BODY]
        response = moment.response
        told = response is not None and response.gain_deviation < IMPRECISE
        if response is None or not told or not shaken or self._resonates(moment.signals, moment.reference):
            self.judgement, self.suspicious = Judgement.NOT_EXCITED, ""
            self._take_gain(moment, None)
            moment.gain.unseen = response is not None and not told
            return None
        self._take_gain(moment, response)
        moment.gain.unseen = False
        if math.isnan(self._reference_residual):
            self.judgement, self.suspicious = Judgement.LEARNING, ""
            return None
        return self._judge(moment, response)

    def relearn(self) -> None:
        """Forget the healthy valve's gain and residual."""
        super().relearn()
        self._reference_residual = self._recent = math.nan
        self._unexplained = self._lost = 0
        self._before = (0.0, 0.0)
        self._found = False

    def restart(self) -> None:
        """Start again after missing samples: the next estimate is still of the valve before and may jump."""
        super().restart()
        self._unexplained, self._lost = -1, 0

    def _compare(self, estimate: Estimate) -> None:
        """Count the estimates in a row that leave more unexplained than the reference."""
        residual = estimate.residual.value
        lost = estimate.state is State.LEARNING and not math.isnan(self._reference_residual)
        self._lost = self._lost + 1 if lost else 0
        if estimate.state is not State.TRACKING or not math.isfinite(residual):
            return
        reference = self._reference_residual
        if math.isnan(reference):
            self._reference_residual = residual
            return
        more = math.sqrt(max(0.0, residual**2 - reference**2))
        limit = max(UNEXPLAINED, TIMES_REFERENCE * reference)
        jumps = min(self._before) < BEFORE * limit < limit < more
        if jumps or (self._unexplained > 0 and more > 0.5 * limit):
            self._unexplained += 1
        elif not self.held:
            self._unexplained = 0
            self._reference_residual += (min(residual, 2.0 * reference) - reference) / FOLLOWED
        self._before = (self._before[1], more)

    def _judge(self, moment: Moment, response: ValveResponse) -> Finding:
        start = moment.learned["channel_gain"]
        if math.isnan(self._recent):
            self._recent = start.value if start.frozen else response.gain
        change = response.gain / self._recent - 1.0
        limit = self.settings[GAIN_CHANGE] + MISFIT * response.misfit
        proven = self._unexplained >= IN_A_ROW or self._lost >= LOST
        proven = proven and not self._explained(moment.stamp)
        if proven and abs(change) > limit:
            self._proven = self._proven if self._found else moment.stamp
            self._found = True
        elif abs(change) < SCALE_SUSPICIOUS * limit:
            self._found = False
        # A valve that changes faster than the response follows bends it for a moment only.
        self.refuted = not self._found and abs(change) < SCALE_SUSPICIOUS * limit
        slow = moment.stamp - self._slow >= GAIN_LASTS * 1e9
        self.refuted = self.refuted and not slow
        if slow:
            self._found, change = True, moment.gain.change
        if self._unexplained == self._lost == 0 and not self._found and not self.held:
            pace = FOLLOWED if abs(change) < SCALE_SUSPICIOUS * limit else SLOWLY
            self._recent += (response.gain - self._recent) / pace
            shown = response.gain, response.bend, response.natural_frequency
            for name, value in zip(self.learns, shown, strict=True):
                moment.learned[name].learn(moment.stamp, value)
        self.judgement = Judgement.JUDGED
        doubtful = slow or ((proven or self._found) and abs(change) > SCALE_SUSPICIOUS * limit)
        self.suspicious = "the ratio of the channels has changed" if doubtful else ""
        gain = Quantity("gain_change", "1", change, response.gain_deviation, Validity.VALID)
        return Finding(
            moment.stamp,
            Severity.ALARM if slow or (self._found and abs(change) > limit) else None,
            not self._found,
            "scale",
            gain,
            lambda: Facts.of(gain, math.copysign(limit, change), "spool"),
        )

    def _take_gain(self, moment: Moment, response: ValveResponse | None) -> None:
        """Compare the gain with its start value, and note since when a valve has not explained the change."""
        moment.gain.update(moment.stamp, response, *(moment.learned[name].value for name in self.learns))
        if not moment.gain.breaks or moment.stamp < self._slow:
            self._slow = moment.stamp

    def _explained(self, stamp: int) -> bool:
        """Whether a change of the valve within what the channels show explains what was seen at ``stamp``."""
        return abs(stamp - self._changed) <= KEPT * 1e9

    def _resonates(self, signals: Signals, reference: ValveResponse) -> bool:
        """Whether the machine shakes the valve, or did until lately, near its natural frequency.

        There the height of the resonance can't be told from a gain, dry friction makes it bend, and a window
        does not resolve it.
        """
        low, high = (reference.natural_frequency * (1.0 + side * NEAR) for side in (-1.0, 1.0))
        near = slice(*np.searchsorted(signals.frequency, (low, high)))
        shaken = float(signals.body_power[near].sum()) > SHAKEN * signals.body_total
        if shaken and float(signals.spool_power[near].sum()) > ANSWERED * signals.spool_total:
            self._near = signals.stamp
        return 0 <= signals.stamp - self._near < BENT * 1e9


class SensorSwapped(Detector):
    """The sign of the power that the relative motion takes."""

    name = "sensor_swapped"
    kind = SWAPPED_KIND
    needs_valve = True
    looks_at = ("signals",)
    rank = 3
    on_delay: ClassVar[float] = 1.5

    def update(self, moment: Moment) -> Finding | None:
        """Judge the window of ``moment``, if there is a new one."""
        if moment.signals is None:
            return None
        if moment.distrust:
            self.judgement, self.suspicious = Judgement.NOT_JUDGED, ""
            return None
        if not moment.signals.relative_rms >= self.settings[MINIMUM_BODY]:
            self.judgement, self.suspicious = Judgement.NOT_EXCITED, ""
            return None
        self.judgement = Judgement.JUDGED
        share = moment.signals.dissipation / moment.reference.damping
        self.suspicious = "the relative motion seems to release energy" if share < 0.5 * NEGATIVE else ""
        dissipation = Quantity("dissipation", "1", share, validity=Validity.VALID)
        return Finding(
            moment.stamp,
            Severity.ALARM if share < NEGATIVE else None,
            share > POSITIVE,
            "swapped",
            dissipation,
            lambda: Facts.of(dissipation, NEGATIVE),
        )


def _channels(signals: Signals) -> dict[str, Channel]:
    return {"body": signals.body, "spool": signals.spool}
