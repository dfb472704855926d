"""Program ``monitor``."""

from functools import partial

from spool_core.node.program import start

main = partial(start, "spool_monitor.monitor_node", "MonitorNode")
