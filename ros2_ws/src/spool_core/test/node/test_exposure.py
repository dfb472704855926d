from __future__ import annotations

import pytest
from spool_core.node.network import WHEELS, network_warnings

LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
ENFORCED = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce", "ROS_SECURITY_KEYSTORE": "/k"}


@pytest.mark.parametrize(
    ("environment", "said"),
    [
        ({}, ["discovery range SUBNET: anyone on this network may"]),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, ["discovery range SUBNET"]),
        (LOCAL, []),
        ({**LOCAL, "ROS_STATIC_PEERS": "10.0.0.7"}, ["ROS_STATIC_PEERS=10.0.0.7"]),
        (ENFORCED, []),
        (
            {**LOCAL, **ENFORCED, WHEELS: "1"},
            ["no DDS security built in: messages are sent and recorded in clear"],
        ),
        ({**ENFORCED, WHEELS: "1"}, ["discovery range SUBNET", "no DDS security built in"]),
        ({**LOCAL, "ROS_SECURITY_KEYSTORE": "/k"}, ["ROS_SECURITY_ENABLE is not true"]),
        ({**LOCAL, "ROS_SECURITY_ENABLE": "true"}, ["ROS_SECURITY_STRATEGY is not Enforce"]),
    ],
)
def test_who_else_can_reach_the_nodes_is_said(environment: dict[str, str], said: list[str]) -> None:
    found = network_warnings(environment)
    assert len(found) == len(said)
    for warning, part in zip(found, said, strict=True):
        assert part in warning
