"""Run everything that ``runs.txt`` lists in a repository, and write what users get, one JSON file a run."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from .reading import content

HERE = Path(__file__).resolve().parent
#: s after which a run is ended.
LONGEST = 1800
#: Keys of how long and when a run was, and of sizes that depend on the speed of the disk.
DROPPED = {"seconds", "elapsed_s", "processor_seconds", "created", "until", "size_bytes"}
_DAYS = "|".join(f"{datetime.now(timezone.utc) + timedelta(days=n):%Y-%m-%d}" for n in (-1, 0, 1))
#: What differs from run to run without meaning anything, and what it becomes.
MASKS = (
    (r"\b(spool )?\d+\.\d+\.\d+ \(commit \w+\+?\)", "VERSION"),
    (rf"\b({_DAYS})([T ]\d\d:\d\d(:\d\d)?(\.\d+)?( ?UTC|Z|\+00:00)?)?", "TODAY"),
    (r"(127\.0\.0\.1:|token_|port from \d+ to )\d+", r"\1PORT"),  # any that was free
    (r"(<not_(after|before)>)[^<]+", r"\1DATE"),
    (r"[\d.]+ (s|min)(?= of computing)", "TIME"),
    (r"[\d.]+ [kMG]?B(?=, closed)", "SIZE"),  # depends on the speed of the disk
    (r"(\.mcap:\d+:)\d+", r"\1TIME"),  # of the file
    (r"_[0-9a-f]{8}(?=\.html)", "_HASH"),  # of the folder
    # Random names, and hashes of files whose parts depend on the speed of the disk.
    (r"(?<![\w.])(?=\d*[a-f])([0-9a-f]{16}|[0-9a-f]{32}|[0-9a-f]{40}|[0-9a-f]{64})(?![\w.])", "HASH"),
    (r"(spool_process_\w+\{.*\}) [\d.e+]+", r"\1 NUMBER"),  # processor time and memory of this process
)
#: Copies, locks and journals of databases.
LEFT_OUT = (".last", ".sqlite-wal", ".sqlite-shm")


def masked(value: Any, places: Mapping[str, str]) -> Any:
    """Return ``value`` without what differs by rule; ``places``: folders and what they become."""
    if isinstance(value, list):
        return [masked(one, places) for one in value]
    if isinstance(value, dict):
        if value.get("name") == "port":  # any that was free
            value = {"name": "port"}
        if "until" in value:  # rates up to now
            value = {key: one for key, one in value.items() if key not in ("per_day", "per_hour")}
        return {masked(key, places): masked(one, places) for key, one in value.items() if key not in DROPPED}
    if isinstance(value, str):
        for place, name in places.items():
            value = value.replace(place, name)
        for pattern, name in MASKS:
            value = re.sub(pattern, name, value)
    return value


def expanded(line: str) -> list[str]:
    """Return the runs that a line with ``{A|B}`` stands for."""
    before, _, rest = line.partition("{")
    choices, _, after = rest.partition("}")
    return (
        [f"{before}{one}{end}" for one in choices.split("|") for end in expanded(after)] if rest else [line]
    )


def listed() -> dict[str, list[str]]:
    """Return the runs by label; that of a run that nobody needs is the command."""
    jobs: dict[str, list[str]] = {}
    lines = (HERE / "runs.txt").read_text("utf-8").splitlines()
    for run in [run for line in lines if not line.startswith("#") for run in expanded(line)]:
        label, command = re.fullmatch(r"(?:(\w+): )?(.*)", run).groups()  # type: ignore[union-attr]
        jobs.setdefault(label or command, []).append(command)
    return jobs


def needed(commands: Sequence[str]) -> set[str]:
    """Return the labels of the runs whose files ``commands`` take."""
    return set(re.findall(r"@(\w+)", " ".join(commands)))


def without_run(known: Iterable[str]) -> list[str]:
    """Return the commands that no line of ``runs.txt`` runs."""
    lines = [f"{command} " for commands in listed().values() for command in commands]
    return [path for path in known if not any(line.startswith(f"{path} ") for line in lines)]


def inputs(folder: Path) -> None:
    """Make wrong files."""
    (folder / "cut").mkdir(parents=True)
    (folder / "cut" / "cut_0.mcap").write_bytes(b"\x89MCAP0\r\n\1\x63\0\0\0\0\0\0\0cut")
    rows = [f"{n / 2000:.5f},{0.5 * (n % 7):.3f},{0.4 * (n % 5):.3f}" for n in range(4000)]
    units = "time_s,body_m_s2,spool_m_s2"
    for name, lines in {
        "empty.csv": [], "words.csv": [units, *rows[:50], "0.03,high,low", *rows[51:]],
        "nounits.csv": ["time,body,spool", *rows], "short.csv": [units, *rows[:20]],
        "broken.yaml": ["id: x", "moving_mass: heavy"],
    }.items():  # fmt: skip
        (folder / name).write_text("\n".join(lines), encoding="utf-8")


def left_in(folder: Path) -> dict[str, Any]:
    """Return the content of every file in ``folder``."""
    files = sorted(one for one in folder.rglob("*") if one.is_file() and one.suffix not in LEFT_OUT)
    return {str(one.relative_to(folder)): content(one) for one in files}


class Collection:
    """Collection in the folder ``out`` of what users get of the repository ``tree``."""

    def __init__(self, out: Path, tree: Path) -> None:
        self.out, self.tree, self.runs = out, tree, out / "runs"
        self.places = {str(out): "OUT", str(tree): "TREE", str(HERE.parent.parent): "TREE"}
        # What another repository or ROS set is not for this one.
        others = re.compile("PYTHON|AMENT|ROS|COLCON|CMAKE|LD_|SPOOL|RMW|RCUTILS")
        own = {"COLUMNS": "120", "TERM": "dumb", "NO_COLOR": "1", "LC_ALL": "C.UTF-8", "TZ": "UTC"}
        self.environment = {key: one for key, one in os.environ.items() if not others.match(key)} | own
        self.environment |= {"XDG_STATE_HOME": str(out / "state"), "ROS_LOG_DIR": str(out / "log")}
        self.known: dict[str, list[str]] = {}
        if out.is_dir() and any(out.iterdir()) and not (out / "public_names.json").exists():
            sys.exit(f"{out}: holds other files than a record: name another folder")
        shutil.rmtree(out, ignore_errors=True)
        self.runs.mkdir(parents=True)

    def write(self, run: str, result: Mapping[str, Any]) -> None:
        """Write what users get of a run."""
        name = re.sub(r"\W+", "_", run)[:120].strip("_")
        told = {"run": run, **masked(result, self.places)}
        (self.out / f"{name}.json").write_text(json.dumps(told, indent=1, default=str), encoding="utf-8")

    def run(self, name: str, command: str, **environment: str) -> None:
        """Run a command in a separate folder and write what it printed and left."""
        folder = self.runs / re.sub(r"\W+", "_", name)[:100]
        folder.mkdir()
        words = shlex.split(re.sub(r"@(\w+)", r"../\1", command))
        path = max((one for one in self.known if f"{command} ".startswith(f"{one} ")), key=len, default="")
        for option, file in (("--json", "result.json"), ("--report", "report.html")):
            if option in self.known.get(path, ()) and option not in words and path != "import":
                words += [option, file]
        ran = self.spool(words, cwd=folder, **environment)
        told = {"text": ran.stdout.splitlines(), "errors": ran.stderr.splitlines(), "files": left_in(folder)}
        self.write(command, {"exit": ran.returncode, **told})
        print(f"{command}: {ran.returncode}", flush=True)

    def spool(self, words: Sequence[str], cwd: Path, **more: str) -> subprocess.CompletedProcess[str]:
        """Run the launcher of the tree; one that does not end is ended by a signal."""
        command = ["timeout", str(LONGEST), str(self.tree / "spool"), *words]
        given = {"env": self.environment | more, "cwd": cwd, "stdin": subprocess.DEVNULL}
        return subprocess.run(command, **given, capture_output=True, text=True, check=False)

    def public(self) -> None:
        """Write the public names; the commands are those that need a run."""
        asked = self.spool(["python", str(HERE / "public.py")], self.out)
        told = json.loads(asked.stdout) if asked.returncode == 0 else {"errors": asked.stderr.splitlines()}
        self.known = told.get("commands", {})
        messages = sorted((self.tree / "ros2_ws" / "src" / "spool_msgs").glob("*/*.[ms][sr][gv]"))
        self.write("public names", told | {"messages": {one.name: content(one) for one in messages}})

    def nodes(self, live: Sequence[str]) -> None:
        """Run the nodes, and the commands that talk to them; write what they publish, keep and serve."""
        folder = self.runs / "nodes"
        command = [str(self.tree / "spool"), "python", str(HERE / "chain.py"), str(folder)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "env": self.environment, "text": True}
        with (
            (self.out / "nodes.log").open("w+", encoding="utf-8") as log,
            subprocess.Popen(command, stderr=log, **pipes) as chain,
        ):
            ready, _, domain = chain.stdout.readline().strip().partition(" ")
            for line in live if ready == "ready" else ():
                self.run(line, line, ROS_DOMAIN_ID=domain, ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
            chain.communicate()
            log.seek(0)
            self.write("nodes: log", {"exit": chain.returncode, "errors": sorted(log.read().splitlines())})
        for part, told in content(folder / "results.json").items() if chain.returncode == 0 else ():
            self.write(part, told)
        for part in ("state", "bag", "snapshots"):
            self.write(f"nodes: files of {part}", left_in(folder / part))

    def collect(self, only: str = "", jobs_at_a_time: int = 2) -> int:
        """Run all, ``jobs_at_a_time`` beside the nodes; return how many commands of the tree have no run.

        ``only``: pattern of the runs that are wanted; those of nodes are ``nodes``.
        """
        inputs(self.runs / "input")
        shutil.copytree(self.tree / "bags", self.runs / "bags")
        self.public()
        jobs = listed() | {f"{path} --help": [f"{path} --help"] for path in self.known}
        live = jobs.pop("live")
        wanted = [label for label, commands in jobs.items() if any(re.search(only, one) for one in commands)]
        for label in wanted:
            wanted += [one for one in jobs.keys() & needed(jobs[label]) if one not in wanted]
        done: dict[str, Future[None]] = {}

        def job(label: str) -> None:
            for name in done.keys() & needed(jobs[label]) - {label}:
                done[name].result()
            for number, command in enumerate(jobs[label]):
                self.run(f"{label}_{number}" if number else label, command)

        with ThreadPoolExecutor(1) as beside, ThreadPoolExecutor(jobs_at_a_time) as pool:
            if re.search(only, "nodes") or any("nodes" in needed(jobs[label]) for label in wanted):
                done["nodes"] = beside.submit(self.nodes, live)
            for label in sorted(jobs, key=lambda one: "nodes" in needed(jobs[one])):
                if label in wanted:
                    done[label] = pool.submit(job, label)
        for one in done.values():
            one.result()
        missing = without_run(self.known)
        for path in missing:
            print(f"no run of ./spool {path}: add a line to {HERE / 'runs.txt'}")
        print(f"{len(list(self.out.glob('*.json')))} runs, {sum(os.times()[:4]):.0f} s of processor time")
        return len(missing)
