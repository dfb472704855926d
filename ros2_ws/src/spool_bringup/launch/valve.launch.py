"""Start the suite for any number of valves: estimator and monitor each, one recorder, simulators on request.

Example: ros2 launch spool_bringup valve.launch.py valves_file:=/etc/spool/valves.yaml simulate:=false
"""

from pathlib import Path

import yaml
from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue

SHARE = Path(get_package_share_directory("spool_bringup"))


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, the nodes of each valve in the list, and the recorder."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "valves_file",
                default_value=str(SHARE / "config" / "valves.yaml"),
                description="YAML list of valves: namespace, and optionally valve_file.",
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=str(SHARE / "config" / "valve.yaml"),
                description="Parameters of all nodes; the shipped file is the manual.",
            ),
            DeclareLaunchArgument(
                "simulate",
                default_value="false",
                choices=["true", "false"],
                description="Start a simulator for each valve in the place of its accelerometers.",
            ),
            DeclareLaunchArgument(
                "record",
                default_value="true",
                choices=["true", "false"],
                description="Record every topic of the valves to MCAP.",
            ),
            DeclareLaunchArgument(
                "output",
                default_value="",
                description="Bag to be made; empty: recording_<time> in the working directory.",
            ),
            DeclareLaunchArgument(
                "state_folder",
                default_value="",
                description="Where the monitors keep alarms, baselines and trends; empty: as in params_file.",
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", choices=["true", "false"], description="Follow /clock."
            ),
            DeclareLaunchArgument(
                "autostart",
                default_value="true",
                choices=["true", "false"],
                description="Configure and activate the nodes at once, without a life cycle manager.",
            ),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context) -> list:
    valves = _read(LaunchConfiguration("valves_file").perform(context))
    common = {
        name: ParameterValue(LaunchConfiguration(name), value_type=bool)
        for name in ("use_sim_time", "autostart")
    }
    params_file = LaunchConfiguration("params_file")
    state_folder = LaunchConfiguration("state_folder").perform(context)
    kept = {"state_folder": ParameterValue(state_folder, value_type=str)} if state_folder else {}
    nodes = []
    for valve in valves:
        own = {"valve_file": valve["valve_file"]} if "valve_file" in valve else {}
        for package, executable, extra, condition in (
            ("spool_estimator", "estimator", own, None),
            ("spool_monitor", "monitor", kept, None),
            ("spool_sim", "simulator", own, IfCondition(LaunchConfiguration("simulate"))),
        ):
            nodes.append(
                LifecycleNode(
                    package=package,
                    executable=executable,
                    name=executable,
                    namespace=valve["namespace"],
                    parameters=[params_file, common, extra],
                    condition=condition,
                    output="screen",
                )
            )
    nodes.append(
        LifecycleNode(
            package="spool_bag",
            executable="recorder",
            name="recorder",
            namespace="",
            parameters=[
                params_file,
                common,
                {
                    "valves": [valve["namespace"] for valve in valves],
                    "output": ParameterValue(LaunchConfiguration("output"), value_type=str),
                },
            ],
            condition=IfCondition(LaunchConfiguration("record")),
            output="screen",
        )
    )
    return nodes


def _read(path: str) -> list:
    """Return the list of valves; what is wrong with it is said with the file and the entry."""
    entries = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    if not isinstance(entries, list) or not entries:
        raise ValueError(f"{path}: give a list of valves, each with a namespace")
    for number, entry in enumerate(entries, 1):
        if not isinstance(entry, dict) or "namespace" not in entry:
            raise ValueError(f"{path}: entry {number} has no namespace")
        unknown = set(entry) - {"namespace", "valve_file"}
        if unknown:
            raise ValueError(f"{path}: entry {number}: unknown key {sorted(unknown)[0]}")
    names = [str(entry["namespace"]).strip("/") for entry in entries]
    if len(set(names)) < len(names):
        raise ValueError(f"{path}: a namespace stands twice, valves must not mix")
    return entries
