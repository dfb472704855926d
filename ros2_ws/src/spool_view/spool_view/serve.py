"""Start of the page from another program, as `./spool watch --web` does."""

from __future__ import annotations

from spool_core.node.parameters import Value, rule
from spool_core.node.running import run

from spool_view.page_node import PageNode

#: Port of the page where nobody names one.
PORT = 8765


def serve(*, port: int = PORT, operator: bool = False, names: tuple[str, ...] = ()) -> None:
    """Serve the page on this host until SIGINT or SIGTERM.

    Args:
        port: on the loopback address.
        operator: whether who has the token may acknowledge, shelve and more; else the page is read only.
        names: of valves; empty for all that are heard.

    Raises:
        SystemExit: the page could not be served; what is wrong was said in one line.
    """
    values: dict[str, Value] = {"port": port, "operator": operator, "valves": list(names) or [""]}
    words = [word for name, value in values.items() for word in rule(name, value)]
    code = run(PageNode, ["--ros-args", *words])
    if code:
        raise SystemExit(code)
