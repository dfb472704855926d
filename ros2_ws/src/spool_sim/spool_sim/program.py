"""Program ``simulator``."""

from functools import partial

from spool_core.node.program import start

main = partial(start, "spool_sim.simulator_node", "SimulatorNode")
