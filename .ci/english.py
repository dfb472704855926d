"""Report words that a reader outside this project stumbles over, and docstrings that repeat a class's name.

python3 .ci/english.py        exit code 1 where there is a finding
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

#: What to write instead, by idiom. Words are matched as they are, across a line break as well.
IDIOMS = {
    "is told": "is reported, gets",
    "are told": "are reported, get",
    "anew": "again",
    "once more": "again",
    "for ever": "forever",
    "in the place of": "instead of",
    "let go of": "release, close",
    "where it can be had": "if it is available",
    "to be had": "available",
    "is asked about": "you are asked for",
    "by the file alone": "from the file only",
    "what has none": "missing ...",
    "goes on for": "lasts",
    "whereof": "of which",
    "whoever": "who, the caller",
    "what is asked": "what is required",
    "what is left": "the remainder, the residual, the rest",
    "what was left": "remains",
    "what is said": "the message, the text, the verdict",
    "what was said": "the message, the verdict",
    "what was heard": "the messages received",
    "told apart": "distinguished",
    "of its own": "separate, its own ...",
    "of their own": "separate, their own ...",
    "be had": "be available",
}
#: Not prose of ours, or names that stored files rely on.
LEFT_OUT = re.compile(
    r"(^|/)(spool_msgs|vendor|docs/results|\.ci/english\.py|tests/law_mutants\.yaml)|"
    r"valve_state\.py|test_baseline_keeper\.py"
)
SUFFIXES = {".py", ".md", ".yaml", ".html", ".js", ".json", ""}
PATTERN = re.compile(
    r"(?<![\w.])(" + "|".join(idiom.replace(" ", r"[ \n]+(?:#: |# )?") for idiom in IDIOMS) + r")(?!\w)",
    re.IGNORECASE,
)


def idioms(path: str, text: str) -> Iterator[str]:
    """Yield a line for each idiom in ``text``."""
    for found in PATTERN.finditer(text):
        idiom = re.sub(r"[\s#:]+", " ", found[1]).lower()
        yield f"{path}:{text.count(chr(10), 0, found.start()) + 1}: '{idiom}': write {IDIOMS[idiom]}"


def repeated_names(path: str, text: str) -> Iterator[str]:
    """Yield a line for each class whose docstring is its name, a colon and what it is for."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ClassDef):
            head, colon, _ = (ast.get_docstring(node) or "").partition("\n")[0].partition(":")
            words = re.sub(r"(?<!^)(?=[A-Z])", " ", node.name).lower()
            if colon and head.lower().replace("-", " ") == words:
                yield f"{path}:{node.lineno}: the docstring of {node.name} begins with its name"


def main() -> int:
    """Print what is found; return the exit code."""
    listed = subprocess.run(["git", "ls-files"], capture_output=True, text=True, check=True).stdout
    findings: list[str] = []
    for path in listed.splitlines():
        file = Path(path)
        if LEFT_OUT.search(path) or file.suffix not in SUFFIXES or file.is_symlink() or not file.is_file():
            continue
        text = file.read_text(encoding="utf-8", errors="replace")
        findings += idioms(path, text)
        if file.suffix == ".py" and "/test" not in path:
            findings += repeated_names(path, text)
    print("\n".join(findings) or "nothing found")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
