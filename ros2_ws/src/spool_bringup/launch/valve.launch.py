"""Start the suite for any number of valves: estimator and monitor each, one recorder, simulators on request.

Example: ros2 launch spool_bringup valve.launch.py valves_file:=/etc/spool/valves.yaml simulate:=false
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from spool_bringup.host.arguments import read_valves
from spool_core.errors import InputError
from spool_core.files import names_node, sections_of
from spool_core.node.parameters import refuse_other_files, rule
from spool_core.system import expanded

SHARE = Path(get_package_share_directory("spool_bringup"))

#: s between the end of a node and its next start: the middleware forgets the dead one meanwhile.
RESPAWN_DELAY = 2.0
#: New starts of a node over a launch's life: what ends every time must not load the machine forever, and one
#: crash a month is let pass for over a year.
RESPAWN_MAX_RETRIES = 20
#: Arguments that are parameters of type bool.
FLAGS = ("use_sim_time", "autostart")
EITHER = ["true", "false"]
#: Arguments: name, default, all values if they are few, and what it is for.
ARGUMENTS = (
    (
        "valves_file", str(SHARE / "config" / "valves.yaml"), None,
        "YAML list of valves: namespace, and optionally valve_file.",
    ),
    (
        "params_file", str(SHARE / "config" / "valve.yaml"), None,
        "Parameters of all nodes; the shipped file is the manual.",
    ),
    ("simulate", "false", EITHER, "Start a simulator for each valve instead of its accelerometers."),
    (
        "adapt", "false", EITHER,
        "Start an adapter for each valve, whose accelerometers have ROS drivers; params_file names their "
        "topics.",
    ),
    (
        "host_processes", "0", None,
        "Processes that host all estimators and monitors together; 0: each node has its own, which suits a "
        "few valves.",
    ),
    (
        "host_sources", "false", EITHER,
        "Run the simulators or adapters in the hosts, too, which then need no messages; with "
        "host_processes.",
    ),
    ("record", "true", EITHER, "Record every topic of the valves to MCAP."),
    (
        "respawn", "true", EITHER,
        f"Start a node that ended again after {RESPAWN_DELAY:g} s, {RESPAWN_MAX_RETRIES} times at most.",
    ),
    (
        "output", "", None,
        "Bag to be made; empty: as in params_file, else recording_<time> in the working directory.",
    ),
    (
        "state_folder", "", None,
        "Where the monitors keep alarms, baselines and trends; empty: as in params_file.",
    ),
    ("use_sim_time", "", ["", *EITHER], "Follow /clock; empty: as in params_file, else false."),
    (
        "autostart", "", ["", *EITHER],
        "Configure and activate the nodes immediately, without a life cycle manager; empty: as in "
        "params_file, else true.",
    ),
)  # fmt: skip


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, the nodes of each valve in the list, and the recorder."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text, choices=choices)
        for name, default, choices, text in ARGUMENTS
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_nodes)])


def _nodes(context) -> list:
    valves = _valves(LaunchConfiguration("valves_file").perform(context))
    params_file = _existing("params_file", LaunchConfiguration("params_file").perform(context))
    # What is passed here rules over params_file: only what was given is.
    common = {**_given(context, "use_sim_time", bool), **_given(context, "autostart", bool)}
    kept = _given(context, "state_folder", str)
    respawn = LaunchConfiguration("respawn").perform(context) == "true"
    again = {"respawn": respawn, "respawn_delay": RESPAWN_DELAY, "respawn_max_retries": RESPAWN_MAX_RETRIES}
    if [LaunchConfiguration(name).perform(context) for name in ("simulate", "adapt")] == ["true", "true"]:
        raise ValueError("adapt: with simulate each valve has two sources: leave one of them out")
    _refuse_stray_sections(params_file, valves)
    hosts = LaunchConfiguration("host_processes").perform(context)
    if not hosts.isdecimal() or int(hosts) > 64:
        raise ValueError(f"host_processes: {hosts} is no number from 0 to 64")
    nodes = []
    sources = {"simulate": "simulator", "adapt": "adapter"}
    hosted = {"estimator", "monitor"} if int(hosts) else set()
    own_source = {}
    if LaunchConfiguration("host_sources").perform(context) == "true":
        given = {flag: LaunchConfiguration(flag).perform(context) for flag in sources}
        wanted = [name for flag, name in sources.items() if given[flag] == "true"]
        if not int(hosts) or not wanted:
            raise ValueError("host_sources: needs host_processes, and simulate or adapt")
        own_source = {"source": wanted[0]}
        hosted |= set(wanted)
    if int(hosts):
        nodes.append(_host(context, hosts, own_source, parameters=[params_file], output="screen", **again))
    for valve in valves:
        own = {"valve_file": valve.valve_file} if valve.valve_file else {}
        for package, executable, extra, condition in (
            ("spool_estimator", "estimator", own, None),
            ("spool_monitor", "monitor", kept, None),
            ("spool_sim", "simulator", own, IfCondition(LaunchConfiguration("simulate"))),
            ("spool_bag", "adapter", {}, IfCondition(LaunchConfiguration("adapt"))),
        ):
            if executable in hosted:
                continue
            nodes.append(
                LifecycleNode(
                    package=package,
                    executable=executable,
                    name=executable,
                    namespace=valve.namespace,
                    parameters=[
                        *_file_for(params_file, f"/{valve.namespace}/{executable}"),
                        {**common, **extra},
                    ],
                    condition=condition,
                    output="screen",
                    **again,
                )
            )
    own = {"valves": [valve.namespace for valve in valves], **_given(context, "output", str)}
    if respawn:  # a recorder that is started again finds the bag that the dead one left
        own["number_output"] = True
    nodes.append(
        LifecycleNode(
            package="spool_bag",
            executable="recorder",
            name="recorder",
            namespace="",
            parameters=[*_file_for(params_file, "/recorder"), {**common, **own}],
            condition=IfCondition(LaunchConfiguration("record")),
            output="screen",
            **again,
        )
    )
    return nodes


def _host(context, processes: str, own: dict, **more) -> Node:
    """Return the node of ``processes`` hosts, with its ``own`` parameters and those given to the launch.

    With -p they are the host's alone. Launch writes a dictionary in `parameters` to a file, for nodes of
    every name, and the host hands parameter files on to the nodes that it hosts.
    """
    given = {**own, "valves_file": LaunchConfiguration("valves_file").perform(context)}
    for name in ("use_sim_time", "autostart", "state_folder"):
        value = LaunchConfiguration(name).perform(context)
        if value:
            given[name] = value == "true" if name in FLAGS else value
    words = [word for name, value in given.items() for word in rule(name, value)]
    arguments = ["--processes", processes]
    return Node(package="spool_bringup", executable="host", arguments=arguments, ros_arguments=words, **more)


def _file_for(path: str, node: str) -> list:
    """Return the parameter file for a node that it has a section for; without one the node refuses it."""
    return [path] if any(names_node(section, node) for section in sections_of(path)) else []


def _refuse_stray_sections(path: str, valves: list) -> None:
    """Refuse sections for nodes of this launch by their last name alone, which reach none of them."""
    of_a_valve = ("estimator", "monitor", "simulator", "adapter")
    nodes = [f"/{valve.namespace}/{name}" for valve in valves for name in of_a_valve] + ["/recorder", "/host"]
    for section in sections_of(path):
        name = section.rpartition("/")[2]
        known = any(node.endswith(f"/{name}") for node in nodes)
        if known and not any(names_node(section, node) for node in nodes):
            raise ValueError(
                f"params_file: {path}: section {section} is for no node of this launch: write /**/{name} for "
                f"that of each valve, or /NAMESPACE/{name} for one"
            )


def _given(context, name: str, kind: type) -> dict:
    """Return the argument ``name`` as a parameter of type ``kind``, nothing where it was not given."""
    if not LaunchConfiguration(name).perform(context):
        return {}
    return {name: ParameterValue(LaunchConfiguration(name), value_type=kind)}


def _existing(argument: str, path: str) -> str:
    """Return ``path``, which must be a file: without their parameter file nodes start on defaults."""
    path = str(expanded(path))
    if not Path(path).is_file():
        raise ValueError(
            f"{argument}: {path} is no file: name the YAML file, e.g. a copy of config/valve.yaml"
        )
    try:
        refuse_other_files(["--params-file", path])
    except InputError as error:
        raise ValueError(f"{argument}: {error}") from None
    return path


def _valves(path: str) -> list:
    """Return the list of valves; an error names the file and the entry."""
    try:
        return read_valves(path)
    except InputError as error:
        raise ValueError(str(error)) from None
