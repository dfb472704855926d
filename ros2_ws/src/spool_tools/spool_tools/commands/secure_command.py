"""`./spool secure`: keystore of the nodes; with --opcua, who may use the OPC UA server and act there."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from enum import Enum
from getpass import getpass
from pathlib import Path
from typing import Annotated

from spool_core.errors import InputError
from spool_report.requests import option

from spool_tools.command import Command, Force


class Source(Enum):
    """Source of a valve's blocks."""

    SIMULATOR = "simulator"
    ADAPTER = "adapter"


def secure(
    keystore: Annotated[Path | None, option("Keystore to make, or to add valves to.", metavar="DIR")] = None,
    valves: Annotated[
        list[str] | None, option("Namespace of a valve; repeatable.", "--valve", metavar="NAMESPACE")
    ] = None,
    source: Annotated[
        Source | None, option("Source of blocks that the host runs itself.", "--hosted-source")
    ] = None,
    opcua: Annotated[Path | None, option("Security folder of the OPC UA server.", metavar="DIR")] = None,
    trust: Annotated[
        list[Path] | None, option("OPC UA client that may connect; repeatable.", metavar="CERTIFICATE")
    ] = None,
    operator: Annotated[
        str | None, option("OPC UA user who may act; asks for a password.", metavar="NAME")
    ] = None,
    _force: Force = False,
) -> None:
    """Make certificates and permissions for every node: who may receive, send and operate.

    Only /operator may call the services of the nodes; the recorder and /viewer only receive.

    Example: ./spool secure --keystore keystore --valve valve_1 --valve valve_2

    Example: ./spool secure --opcua opcua --trust scada.der --operator anna
    """
    if opcua is not None:
        _secure_opcua(opcua, trust or [], operator)
    elif trust or operator:
        raise InputError("--trust, --operator: name the folder of the OPC UA server with --opcua")
    if keystore is not None:
        _secure_nodes(keystore, valves, source)
    elif opcua is None:
        raise InputError("name a folder: --keystore for the nodes, --opcua for the OPC UA server")


def _secure_opcua(folder: Path, trusted: Sequence[Path], operator: str | None) -> None:
    """Make or extend the security folder of the OPC UA server."""
    from spool_core.opcua_folder import CERTIFICATE, keep_operator, make_server, trust  # noqa: PLC0415

    try:
        made = make_server(folder)
        print(f"{folder / CERTIFICATE}: {'made' if made else 'kept'}; clients have to trust it")
        for file in trusted:
            print(f"{file}: trusted, SHA-256 {trust(folder, file)}")
        if operator is not None:
            terminal = sys.stdin.isatty()
            password = getpass(f"password of {operator}: ") if terminal else sys.stdin.readline().rstrip("\n")
            if terminal and getpass("the same again: ") != password:
                raise InputError("the passwords differ: nothing was changed")
            keep_operator(folder, operator, password)
            print(f"{operator}: may act on alarms")
    except OSError as error:
        raise InputError(f"{error.filename or folder}: {error.strerror}") from error
    start = f"./spool run spool_view opcua --ros-args -p security_folder:={folder.absolute()}"
    print(f"start the server with: {start}")


def _secure_nodes(keystore: Path, valves: Sequence[str] | None, source: Source | None) -> None:
    """Make the keystore of the nodes, or add valves to it."""
    from spool_bag import check_valve  # noqa: PLC0415 - slow to load, as below

    from spool_tools.operations.keystore import enclaves_of, make_keystore  # noqa: PLC0415

    names = [valve.strip("/") for valve in valves or ["valve_1"]]
    for name in names:
        check_valve(name)
    enclaves = enclaves_of(names, source.value if source is not None else None)
    make_keystore(keystore, enclaves)
    for name in enclaves:
        print(name)
    print(f"{keystore}: {len(enclaves)} enclaves; on a sourced ROS 2 start a node of them like this:")
    print(f"export ROS_SECURITY_KEYSTORE={keystore.absolute()} ROS_SECURITY_ENABLE=true")
    print("export ROS_SECURITY_STRATEGY=Enforce")
    print(f"ros2 run spool_monitor monitor --ros-args -r __ns:=/{names[0]} --enclave /{names[0]}/monitor")
    print(f"{keystore / 'private'}: keep it off the machine, who has it makes any certificate")


COMMAND = Command(secure, place=245, line="a keystore for secured DDS, with the permissions of every node")
