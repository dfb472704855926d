"""Languages of an event's sentences; the words and templates of each are in a file ``<code>.json``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple


class EventText(NamedTuple):
    """Texts of an event's number: its title, what it means on the machine, and what to do."""

    title: str = ""
    meaning: str = ""
    advice: str = ""


@dataclass(frozen=True, slots=True)
class Language:
    """Words and sentences for all texts of an event.

    Attributes:
        code: ISO 639-1, e.g. ``de``.
        decimal: mark between an integer part and its decimals.
        raised, cleared: templates of headlines.
        events: texts by an event's number; a cause takes what it leaves empty from its kind.
        parameters: names of what is judged.
        words: what codes mean: causes, subjects, notes, urgencies, units of time.
        labels: of the details.
    """

    code: str
    decimal: str
    raised: str
    cleared: str
    events: Mapping[int, EventText]
    parameters: Mapping[str, str]
    words: Mapping[str, str]
    labels: Mapping[str, str]

    def event(self, code: int) -> EventText:
        """Return the texts of the number ``code``; empty where there are none."""
        kind = self.events.get(code - code % 100, EventText(""))
        own = self.events.get(code, kind)
        return EventText(own.title or kind.title, own.meaning or kind.meaning, own.advice or kind.advice)

    def word(self, code: str) -> str:
        """Return what ``code`` means; a code without an entry is its own text."""
        return self.words.get(code) or self.parameters.get(code) or code.replace("_", " ")

    def parameter(self, name: str) -> str:
        """Return the name of the parameter ``name``."""
        return self.parameters.get(name) or name.replace("_", " ")


def load(path: Path) -> Language:
    """Return the language whose texts are in the JSON file ``path``."""
    texts = json.loads(path.read_text(encoding="utf-8"))
    events = {int(code): EventText(**own) for code, own in texts.pop("events").items()}
    return Language(events=events, **texts)


#: Every language by its code: those that have a file here.
LANGUAGES = {path.stem: load(path) for path in sorted(Path(__file__).parent.glob("*.json"))}
ENGLISH = LANGUAGES["en"]
