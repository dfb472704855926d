"""Programs ``recorder`` and ``adapter``."""

from functools import partial

from spool_core.node.program import start

recorder = partial(start, "spool_bag.recorder_node", "RecorderNode")
adapter = partial(start, "spool_bag.adapter_node", "AdapterNode")
