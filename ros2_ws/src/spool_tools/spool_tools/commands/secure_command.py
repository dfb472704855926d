"""`./spool secure`: a keystore for secured DDS, with the permissions of every node."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from spool_tools.command import Command, Force


class Source(Enum):
    """Source of a valve's blocks."""

    SIMULATOR = "simulator"
    ADAPTER = "adapter"


def secure(
    keystore: Annotated[Path, typer.Option(metavar="DIR", help="Keystore to make, or to add valves to.")],
    valves: Annotated[
        list[str] | None, typer.Option("--valve", metavar="NAMESPACE", help="Valve; give it again for more.")
    ] = None,
    source: Annotated[
        Source | None, typer.Option("--hosted-source", help="Source of blocks that the host runs itself.")
    ] = None,
    _force: Force = False,
) -> None:
    """Make certificates and permissions for every node: who may hear, who may send, who may operate.

    Only /operator may call the services of the nodes; the recorder and /viewer hear and change nothing.

    Example: ./spool secure --keystore keystore --valve valve_1 --valve valve_2
    """
    from spool_bag import check_valve  # noqa: PLC0415 - slow to load, as below

    from spool_tools.operations import security as access  # noqa: PLC0415
    from spool_tools.operations.security import make_keystore  # noqa: PLC0415

    names = [valve.strip("/") for valve in valves or ["valve_1"]]
    for name in names:
        check_valve(name)
    enclaves = {
        f"/{valve}/{node}": access.of_node(valve, node) for valve in names for node in access.VALVE_NODES
    }
    enclaves |= {
        "/host": access.of_host(names, source.value if source is not None else None),
        "/recorder": access.of_recorder(names),
        "/viewer": access.of_viewer(names),
        "/operator": access.of_operator(names),
    }
    make_keystore(keystore, enclaves)
    for name in enclaves:
        print(name)
    print(f"{keystore}: {len(enclaves)} enclaves; on a sourced ROS 2 start a node of them like this:")
    print(f"export ROS_SECURITY_KEYSTORE={keystore.absolute()} ROS_SECURITY_ENABLE=true")
    print("export ROS_SECURITY_STRATEGY=Enforce")
    print(f"ros2 run spool_monitor monitor --ros-args -r __ns:=/{names[0]} --enclave /{names[0]}/monitor")
    print(f"{keystore / 'private'}: keep it off the machine, who has it makes any certificate")


COMMAND = Command(secure, place=66, line="a keystore for secured DDS, with the permissions of every node")
