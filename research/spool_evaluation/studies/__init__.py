"""Studies over many records: how often the suite is right. Each is a module with ``run``."""

from __future__ import annotations

#: Module and function of each; the function takes (cases, seed, out, workers).
STUDIES = {
    "field": ("studies.field.study", "run"),
    "estimation": ("studies.estimation", "run"),
    "loggers": ("studies.estimation", "run_loggers"),
    "operation": ("spool_operation.study", "run"),
    "operation-fit": ("spool_operation.surrogate", "run"),
    "operation-agreement": ("spool_operation.agreement", "run"),
    "orders": ("studies.orders", "run"),
    "fleet": ("studies.fleet", "run"),
    "fleet-cost": ("studies.fleet", "run_cost"),
}
