"""Model gap: the estimator's node raises it where its model leaves more over than before."""

from __future__ import annotations

from spool_estimator.gap_requests import MODEL_GAP, MODEL_GAP_CODE, REMEDY, GapChange

from spool_monitor.event import Event, EventKind, EventState, Namur, Severity

KIND = EventKind(
    MODEL_GAP,
    MODEL_GAP_CODE,
    Namur.OUT_OF_SPECIFICATION,
    "A force acts that the model does not have.",
    REMEDY,
)


def gap_event(change: GapChange) -> Event:
    """Return the event that the estimator's node publishes for ``change``."""
    state = EventState.RAISED if change.raised else EventState.CLEARED
    return Event(change.stamp, KIND.name, state, Severity.WARNING, "", change.residual, change.sentence)
