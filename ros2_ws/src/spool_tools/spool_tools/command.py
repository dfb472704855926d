"""Commands: what a command module declares, the group that finds and loads them, options that they share."""

from __future__ import annotations

import errno
import os
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from functools import cache, wraps
from importlib import import_module
from importlib.util import find_spec
from inspect import Parameter, signature
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer
from spool_bag import no_such_bag
from spool_core.discovery import offered
from spool_core.errors import InputError, add_on_missing
from spool_report.outputs import STANDARD_OUTPUT, check_output, replace_existing, text_to_stderr
from spool_report.requests import EXPERT, PART, option
from typer import Typer
from typer.core import TyperGroup
from typer.main import get_group

#: Entry points of this group name packages that hold command modules.
ENTRY_POINTS = "spool.commands"
SUFFIX = "_command"
#: Commands of ``research/``, which only a checkout of the sources has; ``./spool`` puts it on the path.
RESEARCH = "spool_evaluation"
IN_A_CHECKOUT = ("bench", "paper", "study")
#: Panels of the list of commands, and of a command's options.
PANELS = ("Start", "Records", "Running valves", "Simulation and planning", "Add-ons", "Development")
OUTPUT = "Output"
OPTION_PANELS = (None, OUTPUT, PART, EXPERT)


def _json_target(path: Path | None) -> Path | None:
    """Check where JSON goes; ``-`` keeps standard output for it."""
    if path == STANDARD_OUTPUT:
        text_to_stderr()
        return path
    return check_output(path, "--json")


JsonFile = Annotated[
    Path | None,
    option(
        "Write the result as JSON, SI units; - for standard output.",
        "--json",
        panel=OUTPUT,
        callback=_json_target,
    ),
]


def _output(flag: str, text: str, kind: str) -> Any:
    """Return the option of a file to write, which is checked before any work is done."""
    return option(text, flag, panel=OUTPUT, metavar=kind, callback=lambda path: check_output(path, flag))


ReportFile = Annotated[
    Path | None, _output("--report", "Write pictures and tables as one HTML page.", "HTML")
]
ModelFile = Annotated[
    Path | None,
    _output("--save-model", "Write the resulting model as YAML, for simulate and the nodes.", "YAML"),
]
FmuFile = Annotated[
    Path | None,
    _output(
        "--fmu", "Write a valve or a model as an FMU, for Simulink, Modelica tools and others.", "FILE.fmu"
    ),
]
Force = Annotated[
    bool,
    option("Overwrite existing files.", "--force", panel=OUTPUT, is_eager=True, callback=replace_existing),
]


BagArgument = Annotated[Path, typer.Argument(help="rosbag2 directory or .mcap file.", metavar="BAG")]
NewBag = Annotated[Path, option("Bag to be made.", "--out", metavar="BAG")]
OutFolder = Annotated[
    Path | None, option("Folder for all of these files.", "--out", panel=OUTPUT, metavar="DIR")
]
RunningValve = Annotated[str, typer.Argument(metavar="VALVE", help="Namespace of the valve, e.g. valve_1.")]
WhoOption = Annotated[str, option("Name of the operator; default: your user name.", "--who")]
StateFolder = Annotated[
    Path | None, option("State folder of the monitors; default: their default folder.", "--state-folder")
]
CommentOption = Annotated[str, option("Comment.", "--comment")]


def flat(run: Callable[..., None]) -> Callable[..., None]:
    """Return ``run`` with options in place of each argument that is a dataclass: one for each of its fields.

    The panels of its help are in the order of ``OPTION_PANELS``.
    """
    arguments = signature(run, eval_str=True)
    requests: dict[str, Any] = {
        name: one.annotation for name, one in arguments.parameters.items() if is_dataclass(one.annotation)
    }
    options = {name: _options(request) for name, request in requests.items()}

    @wraps(run)
    def flattened(**given: Any) -> None:
        run(**{name: _taken(request, given) for name, request in requests.items()}, **given)

    def place(option: Parameter) -> int:
        panel = next((getattr(one, "rich_help_panel", None) for one in get_args(option.annotation)[1:]), None)
        return OPTION_PANELS.index(panel) if panel in OPTION_PANELS else len(OPTION_PANELS)

    shown = [
        option
        for name, one in arguments.parameters.items()
        for option in options.get(name, [one.replace(kind=Parameter.KEYWORD_ONLY)])
    ]
    shown.sort(key=place)
    flattened.__signature__ = arguments.replace(parameters=shown)  # type: ignore[attr-defined]
    return flattened


def _options(request: type) -> list[Parameter]:
    """Return an argument for each field of ``request``; sequences are lists, which typer knows."""
    kinds = get_type_hints(request, include_extras=True)
    found = []
    for one in fields(request):
        if is_dataclass(kinds[one.name]):
            found += _options(kinds[one.name])
            continue
        kind, option = get_args(kinds[one.name])
        if get_origin(kind) is Sequence:
            kind = list[get_args(kind)]  # type: ignore[misc]
        default = Parameter.empty if one.default is MISSING else one.default
        found.append(
            Parameter(one.name, Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, option])
        )
    return found


def _taken(request: type, given: dict[str, Any]) -> Any:
    """Return the ``request`` that ``given`` arguments ask for; they are removed from it."""
    kinds = get_type_hints(request)
    return request(
        **{
            one.name: _taken(kinds[one.name], given) if is_dataclass(kinds[one.name]) else given.pop(one.name)
            for one in fields(request)
        }
    )


def refuse_missing(*records: Path) -> None:
    """Refuse bags and loggers' files that are missing, before libraries are loaded for a second or two.

    Raises:
        InputError: one is missing.
    """
    for path in records:
        if path.exists():
            continue
        if path.suffix.lower() in ("", ".mcap", ".zstd", ".zst", ".yaml", ".yml"):
            raise no_such_bag(path)
        raise InputError(f"{path}: cannot be read: {os.strerror(errno.ENOENT)}")


#: Settings of a command that passes on what follows its own arguments, options included.
PASSING_ON = {"allow_extra_args": True, "ignore_unknown_options": True, "allow_interspersed_args": False}


#: What to do without commands and nodes that were removed.
GONE = {
    "fleet": add_on_missing("spool_fleet"),
    "plan": add_on_missing("spool_design"),
    "what-if": add_on_missing("spool_design"),
    "layout": "removed: open foxglove.json, lichtblick.json or plotjuggler.xml of spool_view/layouts",
    "plots": "the node was removed: plot fields of the topics estimate and health, see spool_view/layouts",
}


@dataclass(frozen=True, slots=True)
class Command:
    """Command, declared as ``COMMAND`` by a module ``NAME_command.py``; there is no other list of commands.

    ``_`` in the module's name is ``-`` in the command's.

    Attributes:
        run: function with options and arguments in its annotations, or a group of such functions; its
            docstring is the help, with an example.
        place: in the list of commands; the lowest comes first. Hundreds: the panel of ``PANELS``.
        line: what it does, for the list that is shown before anything is installed.
        settings: of the context in which its arguments are parsed.
        live: whether it starts nodes or talks to them.
        offline: commands of a ``live`` group that read files only, so that they need no ROS 2.
    """

    run: Callable[..., None] | Typer
    place: int
    line: str
    settings: Mapping[str, object] = field(default_factory=dict)
    live: bool = False
    offline: tuple[str, ...] = ()


@cache
def command_modules() -> dict[str, str]:
    """Return the full name of each command's module by the command's name."""
    packages = {entry.value for entry in offered(ENTRY_POINTS)}
    if find_spec(RESEARCH) is not None:
        packages.add(f"{RESEARCH}.commands")
    return {
        found.name.removesuffix(SUFFIX).replace("_", "-"): f"{package}.{found.name}"
        for package in sorted(packages)
        for found in pkgutil.iter_modules(import_module(package).__path__)
        if found.name.endswith(SUFFIX)
    }


def declaration(name: str) -> Command:
    """Return what the module of the command ``name`` declares."""
    found: Command = import_module(command_modules()[name]).COMMAND
    return found


class CommandGroup(TyperGroup):
    """Group whose commands are imported one by one, so that none pays for what others need."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands in their places."""
        names = sorted(command_modules(), key=lambda name: declaration(name).place)
        for name in names:
            self.get_command(ctx, name)
        return names

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return name, command and arguments of a call.

        Raises:
            InputError: ROS 2 cannot start in this environment, and the command needs it.
        """
        found = super().resolve_command(ctx, args)
        declared = declaration(found[0]) if found[0] in command_modules() else None
        live = (
            declared is not None and declared.live and found[2][:1] not in ([one] for one in declared.offline)
        )
        if live and "--help" not in args:
            from spool_core.node.network import check_middleware  # noqa: PLC0415 - of live commands alone

            check_middleware()
        return found

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command, ``None`` where there is none.

        Raises:
            InputError: it is in a checkout of the sources only.
        """
        if cmd_name in command_modules():
            if cmd_name not in self.commands:
                declared = declaration(cmd_name)
                around, panel = Typer(rich_markup_mode="rich"), PANELS[declared.place // 100]
                if isinstance(declared.run, Typer):
                    around.add_typer(declared.run, name=cmd_name, rich_help_panel=panel)
                else:
                    settings = dict(declared.settings)
                    around.command(cmd_name, context_settings=settings, rich_help_panel=panel)(
                        flat(declared.run)
                    )
                self.commands[cmd_name] = get_group(around).commands[cmd_name]
        elif cmd_name in GONE:
            raise InputError(f"{cmd_name}: {GONE[cmd_name]}")
        elif cmd_name in IN_A_CHECKOUT:
            raise InputError(
                f"{cmd_name}: this command needs a checkout of the sources: type ./spool {cmd_name} there"
            )
        else:
            self.list_commands(ctx)  # names alike are suggested from what is loaded
        return self.commands.get(cmd_name)
