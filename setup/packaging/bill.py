"""Bill of materials: what the locks install, as CycloneDX 1.6 (ECMA-424) has it."""

from __future__ import annotations

import hashlib
import re
import uuid
from pathlib import Path
from typing import Any

_LOCKED = re.compile(r"^([A-Za-z0-9][A-Za-z0-9._-]*)==([^\s;\\]+)", re.M)
_HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})")


def locked(path: Path) -> dict[str, str]:
    """Return the versions by name that a lock, or a list of requirements, names."""
    return dict(_LOCKED.findall(path.read_text()))


def bill_of_materials(root: Path, version: str) -> dict[str, Any]:
    """Return the bill of the suite at ``version``: every package of ``wheels.lock`` with its hashes."""
    text = (root / "requirements" / "wheels.lock").read_text()
    entries = re.split(r"\n(?=[A-Za-z0-9])", text)
    components = []
    for entry in entries:
        match = _LOCKED.match(entry)
        if match is None:
            continue
        name, release = match[1].lower().replace("_", "-"), match[2]
        components.append(
            {
                "type": "library",
                "bom-ref": f"pkg:pypi/{name}@{release}",
                "name": name,
                "version": release,
                "purl": f"pkg:pypi/{name}@{release}",
                "hashes": [
                    {"alg": "SHA-256", "content": content} for content in sorted(_HASH.findall(entry))
                ],
            }
        )
    components.sort(key=lambda one: str(one["bom-ref"]))
    digest = hashlib.sha256(text.encode()).hexdigest()
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "serialNumber": uuid.uuid5(uuid.NAMESPACE_URL, digest).urn,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": "spool-valves",
                "name": "spool-valves",
                "version": version,
                "licenses": [{"license": {"id": "Apache-2.0"}}],
            }
        },
        "components": components,
        "dependencies": [{"ref": "spool-valves", "dependsOn": [one["bom-ref"] for one in components]}],
    }
