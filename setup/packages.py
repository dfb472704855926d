"""Locked packages of the environment: installed, resumed, compared with the lock."""

from __future__ import annotations

import ast
import os
import re
import shutil
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

from setup.layout import Layout, SetupError
from setup.process import Runner, ask
from setup.requirements import PYTHON

PIN = re.compile(r"^([A-Za-z0-9._-]+)==(\S+)(?: ; (.*?))? ?\\?$")
UV = re.compile(r"^uv==(?:.*\\\n)*.*", re.MULTILINE)
#: Settings of pip and the variables by which uv gets the same.
VARIABLES = {
    "index-url": "UV_DEFAULT_INDEX",
    "cert": "SSL_CERT_FILE",
    "client-cert": "SSL_CLIENT_CERT",
    "proxy": "HTTPS_PROXY",
}
VERSION_BOUND = re.compile(r"python_full_version (<|>=|==) '3\.(\d+)(?:\.\*)?'")
NO_NETWORK = re.compile(
    "NewConnectionError|ConnectTimeout|ConnectionError|ProxyError|NameResolutionError|ReadTimeout"
    "|Network is unreachable|error sending request"
    "|Temporary failure in name resolution|Connection (refused|broken|reset)|Cannot connect to proxy"
)
WRONG_HASH = re.compile(
    r"DO NOT MATCH THE HASHES[^`]*?^ {4}(\S+) from |Hash mismatch for `(\S+)`", re.MULTILINE
)
NOT_FOUND = re.compile(r"No matching distribution found for (\S+)|there is no version of (\S+)")


def locked(lock: Path) -> dict[str, str]:
    """Names and versions that a lock holds for this Python."""
    minor = sys.version_info[1]
    tests = {"<": minor.__lt__, ">=": minor.__ge__, "==": minor.__eq__}
    found = {}
    for line in lock.read_text("utf-8").splitlines():
        if match := PIN.match(line):
            # Conditions on the Python version; the locks know no others on Linux.
            bounds = VERSION_BOUND.findall(match[3] or "")
            if all(tests[operator](int(bound)) for operator, bound in bounds):
                found[_normal(match[1])] = match[2]
    return found


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def site_packages(layout: Layout) -> Path | None:
    """The environment's site-packages, None where it has none."""
    return next(iter((layout.venv / "lib").glob("python3.*/site-packages")), None)


def installed(folders: Iterable[Path]) -> dict[str, str]:
    """Names and versions of the packages in the folders given."""
    from importlib.metadata import distributions  # noqa: PLC0415  (a call that finds all set up needs none)

    entries = distributions(path=[str(folder) for folder in folders])
    return {_normal(entry.metadata["Name"]): entry.version for entry in entries if entry.metadata["Name"]}


def make_venv(layout: Layout, environment: Mapping[str, str], runner: Runner) -> None:
    """Make the environment again.

    Raises:
        SetupError: it could not be made.
    """
    if layout.venv.is_symlink():
        layout.venv.unlink()
    elif layout.venv.exists():
        shutil.rmtree(layout.venv)
    log = runner.log("venv")
    options = [] if layout.underlay.is_wheels else ["--system-site-packages"]
    command: list[str | Path] = [PYTHON, "-m", "venv", *options, layout.venv]
    code, output = runner.run("venv", command, environment)
    if code != 0:
        if "ensurepip" in output and "No space left" not in output:
            raise SetupError(
                f"{PYTHON} cannot make a virtual environment: "
                f"Debian, Ubuntu: apt install python3-venv; see {log}"
            )
        raise failure("the environment could not be made", output, log)


def venv_works(layout: Layout, environment: Mapping[str, str]) -> bool:
    """Whether the environment's interpreter and pip run."""
    try:
        return ask([layout.python, "-I", "-c", "import pip._internal"], environment).returncode == 0
    except OSError:
        return False


def forget_half_installed(layout: Layout) -> None:
    """Remove what a killed installer left, so that the next one does not take it for installed."""
    folder = site_packages(layout)
    for entry in folder.iterdir() if folder else ():
        # pip and uv write INSTALLER after the last file of a package.
        half = entry.name.endswith(".dist-info") and not (entry / "INSTALLER").exists()
        if entry.is_dir() and (half or entry.name.startswith("~")):
            shutil.rmtree(entry)


def install(layout: Layout, environment: Mapping[str, str], runner: Runner) -> None:
    """Install the lock with the uv that it names, which pip brings; installed packages are kept.

    Raises:
        SetupError: names the cause: no network, a wrong hash, a full disk, or the log.
    """
    pip: list[str | Path] = [layout.python, "-m", "pip", "install", "--no-deps", "--require-hashes"]
    pip += ["--retries", "1", "--timeout", "20", "--progress-bar", "off"]
    pip += ["--disable-pip-version-check", "--no-input", "--no-warn-script-location", "-r"]
    own = layout.notes / "uv.txt"
    own.write_text("\n".join(UV.findall(layout.requirements.read_text("utf-8"))), "utf-8")
    # A node starts in half the time with bytecode, also where Python may not write it itself.
    uv: list[str | Path] = [layout.venv / "bin" / "uv", "pip", "install", "--compile-bytecode"]
    uv += ["--no-deps", "--require-hashes", "--no-progress", "--python", layout.python]
    uv += ["-r", layout.requirements]
    settings = uv_settings(pip_settings(layout, environment))
    for command in ([*pip, own], uv):
        code, output = runner.run("install", command, {**environment, **settings})
        if code != 0:
            raise failure("the packages could not be installed", output, runner.log("install"))


def pip_settings(layout: Layout, environment: Mapping[str, str]) -> dict[str, str]:
    """What pip was told in files and variables, by the name of the option."""
    answer = ask([layout.python, "-m", "pip", "config", "list"], environment)
    found: dict[str, str] = {}
    # Sorted by what rules: an option of `install` over `global`, a variable over both.
    for scope in ("global", "install", ":env:"):
        for line in answer.stdout.splitlines():
            match = re.fullmatch(rf"{scope}\.([a-z-]+)=(['\"].*['\"])", line)
            if match:
                found[match[1]] = str(ast.literal_eval(match[2]))
    return found


def uv_settings(pip: Mapping[str, str]) -> dict[str, str]:
    """The variables that tell uv what pip was told.

    Args:
        pip: settings of pip by the name of the option.
    """
    # The lock's hashes decide what is installed, so any index may give it.
    told = {"UV_INDEX_STRATEGY": "unsafe-best-match", "UV_HTTP_TIMEOUT": "20", "UV_HTTP_RETRIES": "1"}
    told |= {VARIABLES[name]: value for name, value in pip.items() if name in VARIABLES and value}
    # pip passes over a folder that is not there, uv refuses it.
    more = [url for url in pip.get("extra-index-url", "").split() if _there(url)]
    links = [place for place in pip.get("find-links", "").split() if _there(place)]
    hosts = pip.get("trusted-host", "").split()
    told |= {"UV_INDEX": " ".join(more)} if more else {}
    told |= {"UV_FIND_LINKS": ",".join(links)} if links else {}
    told |= {"UV_INSECURE_HOST": " ".join(hosts)} if hosts else {}
    if pip.get("keyring-provider", "disabled") != "disabled":
        told["UV_KEYRING_PROVIDER"] = "subprocess"  # the only one of uv
    if pip.get("no-index", "").lower() in ("1", "true", "yes", "on"):
        told["UV_NO_INDEX"] = "1"
    return told


def _there(place: str) -> bool:
    """Whether a place may be asked for packages: an address, or a folder that is there."""
    scheme, separator, path = place.partition("://")
    return (scheme != "file" and bool(separator)) or Path(path if separator else place).exists()


def failure(what: str, output: str, log: Path) -> SetupError:
    """The line for a tool that failed, by the causes that users can do something about."""
    if "No space left on device" in output or "Disk quota exceeded" in output:
        root, temporary = log.parent.parent.parent, os.environ.get("TMPDIR", "/tmp")
        return SetupError(
            f"{what}: the disk that holds {root} or {temporary} is full: free some space and call again"
        )
    if found := WRONG_HASH.search(output):
        return SetupError(
            f"{what}: {found[1] or found[2]} is not the file that the lock was made with: empty the caches "
            f"(pip cache purge, uv cache clean) or ask who runs your package index; see {log}"
        )
    if NO_NETWORK.search(output):
        return SetupError(
            f"{what}: no connection to the package index: "
            f"check network and proxy, then call again to go on; see {log}"
        )
    if found := NOT_FOUND.search(output):
        return SetupError(
            f"{what}: no matching distribution found for {found[1] or found[2]} on your package index: "
            f"check pip's configuration; see {log}"
        )
    errors = [line[7:] for line in output.splitlines() if line.lower().startswith("error: ")]
    return SetupError(f"{what}: {errors[-1] if errors else 'the tool failed'}; see {log}")
