"""Pages and files: the few that there are, read at the start; no name from a browser opens a file."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any

from jinja2 import BaseLoader, Environment, StrictUndefined
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response

from .desk import Desk

SITE = Path(__file__).resolve().parent.parent / "site"
LANGUAGES = ("en", "de")
COOKIE = "spool_language"
_TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
#: Names of valves, as ROS 2 allows them for namespaces.
VALVE = re.compile(r"[A-Za-z0-9_]+(/[A-Za-z0-9_]+)*")
_OWN_PAGE = re.compile(r"/(valve/[A-Za-z0-9_/]{1,200})?")


class Pages:
    """Pages of the site in its languages, and its files."""

    def __init__(self, desk: Desk) -> None:
        self._texts: dict[str, dict[str, Any]] = {
            language: json.loads(SITE.joinpath(f"texts_{language}.json").read_text(encoding="utf-8"))
            for language in LANGUAGES
        }
        environment = Environment(loader=BaseLoader(), autoescape=True, undefined=StrictUndefined)
        self._template = environment.from_string(SITE.joinpath("page.html").read_text(encoding="utf-8"))
        self._files = _files(SITE)
        self._operable = desk.operable

    async def machine(self, request: Request) -> Response:
        """Answer with the machine's page."""
        return self._page(request, "")

    async def valve(self, request: Request) -> Response:
        """Answer with a valve's page."""
        name = request.path_params["name"]
        if len(name) > 200 or not VALVE.fullmatch(name):
            return PlainTextResponse("no such page", 404)
        return self._page(request, name)

    async def file(self, request: Request) -> Response:
        """Answer with a file of the site."""
        found = self._files.get(request.path_params["name"])
        if found is None:
            return PlainTextResponse("no such file", 404)
        content, kind, tag = found
        headers = {"cache-control": "no-cache", "etag": tag}
        if request.headers.get("if-none-match") == tag:
            return Response(status_code=304, headers=headers)
        return Response(content, media_type=kind, headers=headers)

    async def language(self, request: Request) -> Response:
        """Remember the language that is asked for, and go back."""
        code, back = request.path_params["code"], request.query_params.get("to", "/")
        if code not in LANGUAGES or not _OWN_PAGE.fullmatch(back):
            return PlainTextResponse("no such language", 404)
        answer = RedirectResponse(back, 303)
        answer.set_cookie(COOKIE, code, max_age=31_536_000, samesite="strict", httponly=True)
        return answer

    def _page(self, request: Request, valve: str) -> Response:
        language = language_of(request.cookies.get(COOKIE, ""), request.headers.get("accept-language", ""))
        text = self._template.render(
            texts=self._texts[language],
            language=language,
            languages={code: self._texts[code]["language_name"] for code in LANGUAGES},
            valve=valve,
            here=f"/valve/{valve}" if valve else "/",
            operable=self._operable,
        )
        headers = {"cache-control": "no-store", "vary": "accept-language, cookie"}
        return Response(text, media_type="text/html", headers=headers)


def language_of(chosen: str, accepted: str) -> str:
    """Return the language that was chosen, else the best of ``accepted`` (RFC 9110, 12.5.4) that there is."""
    if chosen in LANGUAGES:
        return chosen
    wishes = []
    for part in accepted[:500].split(","):
        name, _, rest = part.strip().partition(";")
        try:
            weight = float(rest.strip().removeprefix("q=") or 1.0)
        except ValueError:
            weight = 0.0
        wishes.append((weight, name.partition("-")[0].lower()))
    wishes.sort(key=lambda wish: -wish[0])
    return next((name for weight, name in wishes if name in LANGUAGES and weight > 0.0), LANGUAGES[0])


def _files(folder: Path) -> dict[str, tuple[bytes, str, str]]:
    """Return content, type and tag of every file for browsers below ``folder``, by its path there."""
    found = {}
    for path in sorted(folder.rglob("*")):
        kind = _TYPES.get(path.suffix)
        if kind is not None:
            content = path.read_bytes()
            tag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
            found[path.relative_to(folder).as_posix()] = (content, kind, tag)
    return found
