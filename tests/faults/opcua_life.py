"""Life of the OPC UA server: it reads its security folder and serves, or says in one line why it does not."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import rclpy
from rclpy.parameter import Parameter
from spool_core.opcua_folder import keep_operator, make_server
from spool_opcua.opcua_node import OpcUaNode


class OpcUaLife:
    """OPC UA node with certificates and an operator."""

    excuses = ("Input/output error",)

    def load(self) -> None:
        """Load nothing: the lives share no data."""

    def prepare(self, disk: Path) -> None:
        """Make certificate, key and an operator."""
        make_server(disk)
        keep_operator(disk, "anna", "a good secret")

    def live(self, disk: Path) -> object:
        """Serve; return whether the node became active."""
        rclpy.init(args=[])
        node = OpcUaNode()
        with socket.socket() as one:
            one.bind(("127.0.0.1", 0))
            values = {"security_folder": str(disk), "port": one.getsockname()[1]}
        node.set_parameters([Parameter(name, value=value) for name, value in values.items()])
        done = rclpy.lifecycle.TransitionCallbackReturn.SUCCESS
        active = node.trigger_configure() == done and node.trigger_activate() == done
        node.trigger_shutdown()
        node.destroy_node()
        rclpy.shutdown()
        return active

    def kept(self, disk: Path) -> dict[str, dict[str, Any]]:
        """Return what the folder holds: the server changes nothing."""
        return {"folder": {path.name: path.read_text("utf-8") for path in disk.iterdir() if path.is_file()}}

    def stated(self, said: str) -> set[str]:
        """Return nothing."""
        return set()


PROCESS = OpcUaLife()
