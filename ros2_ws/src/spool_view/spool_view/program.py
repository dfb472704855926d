"""Programs ``page`` and ``opcua``, the OPC UA server, which is an add-on."""

from functools import partial

from spool_core.node.program import start

page = partial(start, "spool_view.page_node", "PageNode")
opcua = partial(start, "spool_opcua.opcua_node", "OpcUaNode")
