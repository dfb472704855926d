"""Program ``estimator``."""

from functools import partial

from spool_core.node.program import start

main = partial(start, "spool_estimator.estimator_node", "EstimatorNode")
