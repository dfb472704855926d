from __future__ import annotations

from pathlib import Path

import pytest
from spool_core.errors import InputError
from spool_core.node.network import WHEELS, check_middleware, network_warnings

LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
ENFORCED = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce", "ROS_SECURITY_KEYSTORE": "/k"}


@pytest.mark.parametrize(
    ("environment", "said"),
    [
        ({}, ["discovery range SUBNET: anyone on this network may"]),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, ["discovery range SUBNET"]),
        (LOCAL, []),
        ({"ROS_LOCALHOST_ONLY": "1"}, []),
        ({"ROS_LOCALHOST_ONLY": "1", "ROS_STATIC_PEERS": "10.0.0.7"}, []),
        ({"ROS_LOCALHOST_ONLY": "0"}, ["discovery range SUBNET"]),
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


@pytest.mark.parametrize("domain", ["", "0", "232"])
def test_a_domain_and_a_middleware_that_can_be_are_taken(domain: str, tmp_path: Path) -> None:
    check_middleware({**installed(tmp_path), "RMW_IMPLEMENTATION": "rmw_one_cpp", "ROS_DOMAIN_ID": domain})


@pytest.mark.parametrize("domain", ["300", "-1", "press", "1.5"])
def test_a_domain_that_cannot_be_is_refused(domain: str) -> None:
    with pytest.raises(InputError, match=f"ROS_DOMAIN_ID={domain} is no domain: .* a number from 0 to 232"):
        check_middleware({"ROS_DOMAIN_ID": domain})


def test_a_middleware_that_is_not_installed_is_refused_with_those_that_are(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="rmw_two_cpp is not installed; this ROS 2 has rmw_one_cpp: unset"):
        check_middleware({**installed(tmp_path), "RMW_IMPLEMENTATION": "rmw_two_cpp"})


def installed(prefix: Path) -> dict[str, str]:
    for kind in ("packages", "rmw_typesupport_cpp"):
        folder = prefix / "share/ament_index/resource_index" / kind
        folder.mkdir(parents=True)
        (folder / "rmw_one_cpp").touch()
    return {"AMENT_PREFIX_PATH": f"/nowhere:{prefix}"}
