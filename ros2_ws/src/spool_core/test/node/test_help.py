"""What ``--help`` of a node shows."""

from typing import ClassVar

import pytest
from spool_core.node.managed_node import ManagedNode
from spool_core.node.parameters import NodeParameter
from spool_core.node.running import run


class Pump(ManagedNode):
    """Pump oil.

    At the pace of the shaft.
    """

    PARAMETERS: ClassVar = (
        NodeParameter("speed", 1500.0, "Speed of the shaft.", "rpm", 0.0, 3000.0),
        NodeParameter("side", "left", "Where it sits.", choices=("left", "right")),
    )


def test_help_names_every_parameter_and_starts_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(Pump, ["--help"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("Pump oil.\n")
    assert "speed = 1500.0 rpm, 0 to 3000\n      Speed of the shaft." in shown
    assert "side = 'left', one of left, right" in shown
    assert "autostart = True" in shown
