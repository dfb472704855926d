"""Installation with uv, in a tenth of pip's time, from the indexes that pip is configured for."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from pathlib import Path

from setup.layout import Layout
from setup.process import Runner, ask

#: Settings of pip that uv has no equal for: pip installs alone then.
ONLY_PIP = {"client-cert", "keyring-provider"}
#: Settings of pip and the variables by which uv gets the same.
VARIABLES = {"index-url": "UV_DEFAULT_INDEX", "cert": "SSL_CERT_FILE", "proxy": "HTTPS_PROXY"}
REQUIREMENT = re.compile(r"^uv==(?:.*\\\n)*.*", re.MULTILINE)


def install(layout: Layout, environment: Mapping[str, str], runner: Runner) -> bool:
    """Install the lock with the uv that it names, which pip brings.

    Returns:
        Whether that went well; where it did not, pip can install the lock and says what is wrong.
    """
    named = REQUIREMENT.search(layout.requirements.read_text())
    told = settings(pip_settings(layout, environment))
    if named is None or told is None:
        return False
    own = layout.notes / "uv.txt"
    own.write_text(named[0] + "\n")
    pip: list[str | Path] = [
        layout.python,
        "-m",
        "pip",
        "install",
        "-r",
        own,
        "--no-deps",
        "--require-hashes",
    ]
    pip += ["--retries", "1", "--timeout", "20", "--disable-pip-version-check", "--no-input", "--quiet"]
    if runner.run("install", pip, environment)[0] != 0:
        return False
    uv: list[str | Path] = [layout.venv / "bin" / "uv", "pip", "install", "--python", layout.python]
    # A node starts in half the time, also where Python may not write bytecode itself.
    uv += ["--compile-bytecode"]
    uv += ["--no-deps", "--require-hashes", "--no-progress", "-r", layout.requirements]
    return runner.run("install", uv, {**environment, **told})[0] == 0


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


def settings(pip: Mapping[str, str]) -> dict[str, str] | None:
    """The variables that tell uv what pip was told, None where it cannot be told.

    Args:
        pip: settings of pip by the name of the option.
    """
    if not ONLY_PIP.isdisjoint(pip):
        return None
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
    if pip.get("no-index", "").lower() in ("1", "true", "yes", "on"):
        told["UV_NO_INDEX"] = "1"
    return told


def _there(place: str) -> bool:
    """Whether a place may be asked for packages: an address, or a folder that is there."""
    scheme, separator, path = place.partition("://")
    return (scheme != "file" and bool(separator)) or Path(path if separator else place).exists()
