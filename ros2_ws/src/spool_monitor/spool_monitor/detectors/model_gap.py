"""Model gap: the estimator's node raises it where its model leaves more over than before."""

from __future__ import annotations

from spool_estimator.gap_watch import MODEL_GAP, MODEL_GAP_CODE, NAMUR

from spool_monitor.event import EventKind

KIND = EventKind(MODEL_GAP, MODEL_GAP_CODE, NAMUR)
