"""Text for people: sentences, suggestions for misspelt words, and what a terminal can print.

The order is fixed: what and how large, against what it was; since when; the causes with their shares; how
sure; how urgent; what to do. An event that ended says what is over, after how long, and what is seen now; it
advises nothing.
"""

from __future__ import annotations

import difflib
import math
import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import PurePath

from spool_core.uncertainty import UNKNOWN, compared, unit_text

#: Share of a cause below which it is not worth reading.
WORTH_SAYING = 0.1

#: s below which the beginning is now.
NOW = 0.1

_MINUTE, _HOUR, _DAY = 60.0, 3600.0, 86400.0

#: Least similarity of a name that is suggested: difflib's own default.
SIMILAR = 0.6


@dataclass(frozen=True, slots=True)
class ShareOfCause:
    """Share of one possible cause: its ``share`` among all (0 to 1), and what else speaks for it."""

    name: str
    share: float
    evidence: str = ""


@dataclass(frozen=True, slots=True)
class Account:
    """Account of a condition: what it has to tell.

    Attributes:
        observation: what is seen, with its numbers; true whether the condition begins or ends.
        judgement: what that means; said only when it begins.
        began: how long ago, s; NaN where it is not known.
        causes: ranked, the most likely one first.
        sure: what speaks for it being no chance.
        urgent: how soon somebody has to act.
        outlook: when a limit is reached, or that nothing tells.
        hurries: that limit is near.

    """

    observation: str
    judgement: str = ""
    began: float = math.nan
    causes: tuple[ShareOfCause, ...] = field(default=())
    sure: str = ""
    urgent: str = ""
    outlook: str = ""
    hurries: bool = False


def raised(account: Account, remedy: str = "") -> str:
    """Return the sentence of a condition that began or grew; ``remedy``: what to do, empty where nothing."""
    first = f"{account.observation}: {account.judgement}" if account.judgement else account.observation
    clauses = [first]
    if account.began >= NOW:
        clauses.append(f"began about {duration(account.began)} ago")
    clauses += _causes(account.causes)
    if account.sure:
        clauses.append(f"how sure: {account.sure}")
    if account.urgent:
        urgent = ", ".join(part for part in (account.urgent, account.outlook) if part)
        clauses.append(f"how urgent: {urgent}")
    if remedy:
        clauses.append(f"what to do: {remedy}")
    return "; ".join(clauses)


def urgency(letter: str, *, alarm: bool, hurries: bool = False) -> str:
    """Return how soon somebody has to act, by the status ``letter`` after NAMUR NE 107 and the severity.

    ``hurries``: what is only due to be planned reaches its limit before a plan would. Empty for a
    letter that asks nobody to act.
    """
    reserve = "soon, its reserve runs down fast" if hurries else "plan it, its reserve runs down"
    return {
        "F": "at once, it does not do what it should (NE 107: F, failure)",
        "C": "when the check is over (NE 107: C, function check)",
        "S": f"{'at once' if alarm else 'soon'}, it works outside of what it was made for "
        "(NE 107: S, out of specification)",
        "M": f"{'soon, its reserve is used up' if alarm else reserve} (NE 107: M, maintenance required)",
    }.get(letter, "")


def over(kind: str, account: Account, lasted: float = math.nan) -> str:
    """Return the sentence of a condition of ``kind`` that ended after ``lasted`` s (NaN: not known)."""
    after = f" after {duration(lasted)}" if lasted >= 0.0 else ""
    return f"{_words(kind)} is over{after}: {account.observation}"


def change(
    name: str,
    unit: str,
    now: tuple[float, float],
    baseline: tuple[float, float],
    *,
    relative: bool,
) -> str:
    """Return how a parameter changed, e.g. ``Coulomb force rose by 0.250 N to 0.350 ± 0.011 N, ...``.

    What it rose or fell by is the difference of the two numbers shown, or their ratio's.

    Args:
        name: of the parameter.
        unit: of both.
        now: value and standard deviation, in ``unit``.
        baseline: value and standard deviation of the healthy valve, in ``unit``.
        relative: say the change in % of the baseline.

    """
    there, here = compared(baseline, now)
    suffix, name = unit_text(unit), _words(name)
    if UNKNOWN in (there.value, here.value):
        return f"{name} {here.value}, baseline {there.value}"
    begin, end = Decimal(there.value), Decimal(here.value)
    intervals = f"{here}{suffix}, baseline {there}{suffix} (± 95 %)"
    difference = end - begin
    if difference == 0:
        return f"{name} as before at {intervals}"
    verb = "rose" if difference > 0 else "fell"
    size = f"{_percent(abs(100 * difference / begin))} %" if relative and begin else ""
    return f"{name} {verb} by {size or f'{_in_digits(abs(difference), there.value)}{suffix}'} to {intervals}"


def duration(seconds: float) -> str:
    """Return a time span as people say it: ``7.2 s``, ``34 min``, ``12 h``, ``5 days``."""
    if seconds < 2.0 * _MINUTE:
        return f"{seconds:.1f} s"
    if seconds < 2.0 * _HOUR:
        return f"{seconds / _MINUTE:.0f} min"
    return f"{seconds / _HOUR:.0f} h" if seconds < 2.0 * _DAY else f"{seconds / _DAY:.0f} days"


def plural(count: int, thing: str) -> str:
    """Return e.g. ``1 valve`` or ``20 valves``."""
    return f"{count} {thing}" + ("" if count == 1 else "s")


def did_you_mean(given: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean NAME?"`` for the known name nearest to ``given``, empty where none is near.

    Upper and lower case, ``-`` for ``_`` and the folder and ending of a path make no difference.
    """
    by_form = {_form(name): name for name in known}
    for form in (_form(given), _form(PurePath(given).stem)):
        near = difflib.get_close_matches(form, by_form, n=1, cutoff=SIMILAR)
        if near:
            return f"; did you mean {by_form[near[0]]}?"
    return ""


def printable(text: object, longest: int = 2000) -> str:
    """Return ``text`` with every character that is not printable (Unicode) written as its escape.

    Args:
        text: of any origin.
        longest: characters kept; what is longer ends in ``...``.
    """
    whole = str(text)
    cut = whole if len(whole) <= longest else whole[: longest - 3] + "..."
    return cut if cut.isprintable() else "".join(map(_shown, cut))


def keep_standard_streams() -> None:
    """Open ``/dev/null`` in place of closed standard streams.

    The next file that is opened would get their number, and what libraries print would go into it.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            # The lowest free number is given, which is this one.
            os.open(os.devnull, os.O_RDONLY if descriptor == 0 else os.O_WRONLY)
            os.set_inheritable(descriptor, True)  # what is started needs its streams as well
    if sys.stdout is None:
        sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115 - open for the life of the process
    if sys.stderr is None:
        sys.stderr = open(2, "w", closefd=False)  # noqa: SIM115


def drop_output() -> None:
    """Let what is still to be printed go nowhere: the reader (``| head``) has ended."""
    null = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(null, stream.fileno())
    os.close(null)


def _causes(causes: tuple[ShareOfCause, ...]) -> list[str]:
    said = [cause for cause in causes if cause.share >= WORTH_SAYING]
    if not said:
        return []
    first, *others = [
        f"{_words(cause.name)}, share {cause.share:.2f}" + (f" ({cause.evidence})" if new else "")
        for place, cause in enumerate(said)
        for new in (cause.evidence and cause.evidence not in {one.evidence for one in said[:place]},)
    ]
    return ["; or ".join([f"most likely cause: {first}", *others])]


def _words(name: str) -> str:
    """Return an identifier as words; Coulomb is a name."""
    return name.replace("_", " ").replace("coulomb", "Coulomb")


def _percent(value: Decimal) -> str:
    """Return two digits at least."""
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}" if value >= 1 else f"{value:.1g}"


def _in_digits(difference: Decimal, like: str) -> str:
    """Return ``difference`` down to the last digit of ``like``, with its power of ten."""
    mantissa, mark, power = like.partition("e")
    decimals = len(mantissa.partition(".")[2])
    return f"{difference.scaleb(-int(power or 0)):.{decimals}f}{mark}{power}"


def _form(name: str) -> str:
    return name.lower().replace("-", "_").replace(" ", "_")


def _shown(letter: str) -> str:
    if letter.isprintable():
        return letter
    return letter.encode("unicode_escape", "surrogatepass").decode("ascii")
