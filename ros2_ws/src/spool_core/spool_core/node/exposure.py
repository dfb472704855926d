"""Exposure: who else can reach this process's nodes, as its environment variables say; loads no library."""

from __future__ import annotations

import os
from collections.abc import Mapping

#: Set by what starts the nodes on the wheels from PyPI, whose middleware has no DDS security built in.
WHEELS = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


def network_warnings(environment: Mapping[str, str] | None = None) -> list[str]:
    """Return what lets others in, one sentence each with what to do; none where nothing does.

    Variables as of ROS 2 Jazzy: ``ROS_AUTOMATIC_DISCOVERY_RANGE`` (unset: SUBNET), ``ROS_STATIC_PEERS``,
    ``ROS_SECURITY_ENABLE``, ``ROS_SECURITY_STRATEGY`` (unset: Permissive), ``ROS_SECURITY_KEYSTORE``.
    """
    environment = os.environ if environment is None else environment
    said = []
    on = environment.get("ROS_SECURITY_ENABLE", "").lower() == "true"
    enforced = on and environment.get("ROS_SECURITY_STRATEGY", "") == "Enforce"
    built_in = not environment.get(WHEELS)
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "") or "SUBNET"  # the default of Jazzy
    if reach in ("SUBNET", "SYSTEM_DEFAULT") and not (enforced and built_in):
        said.append(
            f"discovery range {reach}: anyone on this network may read the samples, acknowledge and shelve "
            "alarms; set ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, or use a network of the machine's own"
        )
    peers = environment.get("ROS_STATIC_PEERS", "")
    if peers and not (enforced and built_in):
        said.append(f"ROS_STATIC_PEERS={peers}: each of these hosts may acknowledge and shelve alarms")
    return [*said, *_security(environment, on=on, enforced=enforced, built_in=built_in)]


def _security(environment: Mapping[str, str], *, on: bool, enforced: bool, built_in: bool) -> list[str]:
    set_ = sorted(name for name in environment if name.startswith("ROS_SECURITY_") and environment[name])
    if not set_:
        return []
    if not built_in:
        return [
            f"{', '.join(set_)} set, but this ROS 2 (wheels from PyPI) has no DDS security built in: "
            "messages are sent and recorded in clear, and nobody is kept out; install ROS 2's own packages "
            "for that"
        ]
    if not on:
        return [
            f"{', '.join(set_)} set, but ROS_SECURITY_ENABLE is not true: messages are sent and recorded in "
            "clear; set ROS_SECURITY_ENABLE=true and ROS_SECURITY_STRATEGY=Enforce"
        ]
    if not enforced:
        return [
            "ROS_SECURITY_STRATEGY is not Enforce: a node without a key runs unsecured, in clear; "
            "set ROS_SECURITY_STRATEGY=Enforce"
        ]
    return []
