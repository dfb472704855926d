"""Read YAML of any origin within bounds: a few bytes of it can stand for gigabytes or end the stack."""

from __future__ import annotations

from typing import Any

import yaml

#: A bag's metadata nests 8 deep (rosbag2, version 9) and has about 400 B a topic and 300 B a file.
DEEPEST = 32
LARGEST = 1 << 24


class YamlError(ValueError):
    """A text is no YAML, or beyond the bounds."""


_Loader: type[Any] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def load_bounded(text: str) -> Any:
    """Return what ``text`` holds, of plain types only.

    Raises:
        YamlError: not YAML, larger than ``LARGEST`` B, nested deeper than ``DEEPEST``, or with aliases.
    """
    if len(text) > LARGEST:
        raise YamlError(f"it has {len(text)} characters, more than {LARGEST}")
    try:
        depth = 0
        for event in yaml.parse(text, Loader=_Loader):
            if isinstance(event, yaml.AliasEvent):
                raise YamlError("it has aliases, which are not read")
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST:
                raise YamlError(f"it is nested deeper than {DEEPEST}")
        return yaml.load(text, Loader=_Loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise YamlError(" ".join(str(error).split())[:200]) from error
