"""Program ``estimator``."""

from __future__ import annotations

from spool_node.program import start


def main() -> int:
    """Run the node."""
    return start("spool_estimator.node.estimator_node", "EstimatorNode")
