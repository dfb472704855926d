"""Dead channel: one accelerometer shows next to nothing though the other one does, or no sample changes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array
from spool_core.uncertainty import Quantity, Validity

from spool_monitor.channels import Channel, Signals, transfer
from spool_monitor.event import EventCause, Facts, Finding, Severity
from spool_monitor.window import Complex

from .base import MINIMUM_BODY, SIGNALS, Detector, Judgement, Moment, MonitorSettings
from .sensor_fault import sensor_fault

KIND = sensor_fault(EventCause("dead", 601))


#: Share of what is due below which a channel is dead, and above which it lives.
DEAD, ALIVE = 0.12, 0.25

#: Response below which a line of the spool says nothing of the body, and share of the reference damping
#: from which both channels have something in common: then neither is dead.
FOLLOWS, COMMON = 0.3, 0.4

#: Squared coherence with what is due, from which a channel follows the other one, and share of what is due
#: below which it is dead all the same: so much crosses over between the cables of two channels.
COHERENT, DEAF = 0.5, 0.04

#: s without a change from which a channel stands still, and from which it is suspicious; with the delay of
#: the condition and a look every half second the fault is raised 1.25 s to 1.75 s after the last change.
STANDS, SUSPICIOUS = 0.25, 0.05

#: m/s^2, step of a converter from which a machine at rest may show no noise at all: accelerometers for
#: machines have 0.002 to 0.05 m/s^2 rms of it. Steps by which such a reading may swing before it stands: more
#: is no vibration that dies away.
COARSE, SWINGS = 0.005, 3.0


class SensorDead(Detector):
    """Samples that do not change, or a level far below what the other channel makes due.

    A machine at rest behind a coarse converter shows no change either: there a channel must have stopped in
    the midst of a motion.
    """

    name = "sensor_dead"
    kind = KIND
    looks_at = (SIGNALS,)
    rank = 0
    on_delay: ClassVar[float] = 1.0

    def __init__(self, settings: MonitorSettings) -> None:
        super().__init__(settings)
        self._steps = {"body": math.nan, "spool": math.nan}
        self._stopped = {"body": True, "spool": True}
        self._stood = False

    def update(self, moment: Moment) -> Finding | None:
        """Judge the window of ``moment``, if there is a new one."""
        signals = moment.signals
        if signals is None:
            return None
        standing = self._standing(signals)
        if standing:
            return self._stand(moment, signals, standing)
        return self._compare(moment, signals)

    def _standing(self, signals: Signals) -> tuple[str, ...]:
        """Return the names of the channels that stand still and should not."""
        found = []
        for name, channel in _channels(signals).items():
            self._steps[name] = _least(self._steps[name], channel.step)
            coarse = self._steps[name] >= COARSE
            if channel.standing == 0.0:
                self._stopped[name] = True
            elif not math.isnan(channel.before):
                self._stopped[name] = channel.before > SWINGS * self._steps[name]
            if channel.standing >= SUSPICIOUS and (self._stopped[name] or not coarse):
                found.append(name)
        return tuple(found)

    def _stand(self, moment: Moment, signals: Signals, names: tuple[str, ...]) -> Finding:
        channels = _channels(signals)
        seconds = min(channels[name].standing for name in names)
        self.judgement = Judgement.JUDGED
        both = len(names) == 2
        self.suspicious = f"the {' and the '.join(names)} accelerometer stand{'' if both else 's'} still"
        self._stood = self._stood or seconds >= STANDS
        level = Quantity("channel_level", "1", 0.0, validity=Validity.VALID)

        def facts() -> Facts:
            means = [
                Quantity(f"{name}_mean", "m/s^2", channels[name].mean, validity=Validity.VALID)
                for name in names
            ]
            unchanged = Quantity("unchanged_time", "s", seconds, validity=Validity.VALID)
            own = Facts.of(level, DEAD, "both" if both else names[0])
            return replace(own, evidence=(unchanged, *means))

        dead = Severity.ALARM if seconds >= STANDS else None
        return Finding(moment.stamp, dead, False, "dead", level, facts)

    def _compare(self, moment: Moment, signals: Signals) -> Finding | None:
        """Compare each channel's level with what the reference response makes of the other one."""
        reference = moment.reference
        shares: dict[str, float] = {}
        due = seen = dict.fromkeys(("spool", "body"), math.nan)
        if moment.described and not moment.distrust:
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
            follows = common > COHERENT and min(shares.values(), default=0.0) > DEAF
            if follows or abs(signals.dissipation) > COMMON * reference.damping:
                shares = dict.fromkeys(shares, 1.0)
        self.judgement = Judgement.JUDGED if shares else Judgement.NOT_EXCITED
        if moment.distrust or not moment.described:
            self.judgement = Judgement.NOT_JUDGED
        name = min(shares, key=lambda one: shares[one], default="spool")
        share = shares.get(name, math.nan)
        dead = share < DEAD
        self._stood = self._stood and not dead
        self.suspicious = f"the {name} accelerometer shows next to nothing" if share < ALIVE else ""
        validity = Validity.VALID if shares else Validity.UNKNOWN
        level = Quantity("channel_level", "1", share, validity=validity)

        def facts() -> Facts:
            if not shares:
                return Facts(note="changes_again")
            further = (("shown_acceleration", seen[name]), ("expected_acceleration", due[name]))
            evidence = tuple(Quantity(key, "m/s^2", one, validity=Validity.VALID) for key, one in further)
            return replace(Facts.of(level, DEAD, name), evidence=evidence)

        return Finding(
            moment.stamp,
            Severity.ALARM if dead else None,
            min(shares.values()) > ALIVE if shares else self._stood,
            "dead",
            level,
            facts,
        )


def _channels(signals: Signals) -> dict[str, Channel]:
    return {"body": signals.body, "spool": signals.spool}


def _least(old: float, new: float) -> float:
    return new if math.isnan(old) else old if math.isnan(new) else min(old, new)


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
