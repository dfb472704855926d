"""Encoding of a logger's text: from its first bytes, from words that loggers write, or else guessed."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from spool_core.errors import InputError

#: Encodings of text that is not Unicode, and their usual names, most common first.
_SINGLE = {
    "cp1252": "Windows-1252 (Western European)",
    "gb18030": "GBK (simplified Chinese)",
    "cp932": "Shift-JIS (Japanese)",
    "cp1251": "Windows-1251 (Cyrillic)",
    "cp1250": "Windows-1250 (Central European)",
    "big5": "Big5 (traditional Chinese)",
    "cp949": "EUC-KR (Korean)",
    "cp850": "DOS 850 (Western European)",
}
#: Words and units that stand above the samples of loggers; one of them found decides for an encoding.
_WORDS = re.compile(
    r"s²|°[cf]|µ[msvg]|gehäuse|öl|größe|für|prüf|über|zähler|länge|kanäle|(?<=[a-z])[éèçñãäöüß](?=[a-z])|"
    r"时间|时刻|阀|通道|采样|采集|温度|加速度|速度|位移|压力|测量|数据|日期|油温|频率|单位|序号|传感|"
    r"時間|時刻|測定|チャンネル|ボディ|スプール|サンプ|加速度|温度|変位|圧力|周波数|単位|日時|データ|"
    r"время|корпус|золотник|канал|температур|ускорени|датчик|частот|масл|давлени|перемещ|дата|"
    r"częst|przysp|próbk|położ|ciśn|zrychl|teplot|čas|idő|時|시간|가속도|온도|채널|밸브|스풀",
    re.IGNORECASE,
)


def encoding_of(path: Path, start: bytes) -> tuple[str, str]:
    """Return the encoding of a text by its first bytes, and a note where it is assumed, "" where it is sure.

    Raises:
        InputError: it is no text.
    """
    if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16", ""
    text = start.rstrip(b"\0")  # space that a logger had reserved
    even, odd = text[0::2].count(0), text[1::2].count(0)
    if odd > 0.3 * len(text) and not even:
        return "utf-16-le", ""
    if even > 0.3 * len(text) and not odd:
        return "utf-16-be", ""
    if b"\0" in text or len(re.findall(rb"[\x01-\x08\x0e-\x1a\x1c-\x1f]", text)) > 0.01 * len(text):
        raise InputError(
            f"{path}: it is a binary file, not a CSV text, and of no format that is read: export the "
            "record as CSV"
        )
    try:
        codecs.getincrementaldecoder("utf-8")().decode(text)
    except UnicodeDecodeError:
        found = _legacy(text)
        return found, f"text assumed to be {_SINGLE[found]}, since it is no UTF-8"
    return ("utf-8-sig" if text.startswith(codecs.BOM_UTF8) else "utf-8"), ""


def _legacy(text: bytes) -> str:
    """Return the encoding in which a text, no UTF-8, makes most sense."""
    lines = b"\n".join(line for line in text.split(b"\n")[:500] if re.search(rb"[\x80-\xff]", line))
    if not lines:  # beyond the lines by which it is known
        return "cp1252"
    scores: dict[str, int] = {}
    for encoding in _SINGLE:
        try:
            decoded = lines.decode(encoding)
        except UnicodeDecodeError:
            continue
        scores[encoding] = len(_WORDS.findall(decoded))
    best = max(scores, key=lambda name: scores[name], default="cp1252")
    return best if scores.get(best) else _guessed(lines)


def _guessed(lines: bytes) -> str:
    try:
        from charset_normalizer import from_bytes  # noqa: PLC0415 - 20 ms, for few files
    except ImportError:
        return "cp1252"
    found = from_bytes(lines, cp_isolation=["cp1252", "gb18030", "cp932", "cp1251"]).best()
    names = {codecs.lookup(name).name: name for name in _SINGLE}
    return names.get(codecs.lookup(found.encoding).name, "cp1252") if found is not None else "cp1252"
