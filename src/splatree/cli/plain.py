"""Text for consoles that are not UTF-8: what they lack is spelled out, the rest is replaced."""

import sys
from typing import TextIO

__all__ = ["holds_all", "printable", "tolerant"]

SPELLED = {
    "τ": "tau",
    "λ": "lambda",
    "γ": "gamma",
    "σ": "sigma",
    "Σ": "sum",
    "α": "alpha",
    "π": "pi",
    "×": "x",
    "·": "*",
    "√": "sqrt ",
    "²": "^2",
    "³": "^3",
    "⁴": "^4",
    "½": "1/2",
    "±": "+-",
    "−": "-",
    "–": "-",
    "—": "-",
    "…": "...",
    "≤": "<=",
    "≥": ">=",
    "≠": "!=",
    "≈": "about ",
    "→": "->",
    "°": " deg",
    "’": "'",
    "‘": "'",
    "“": '"',
    "”": '"',
    "│": "|",
    "─": "-",
    "█": "#",
    "▇": "#",
    "▆": "#",
    "▅": "+",
    "▄": "+",
    "▃": "-",
    "▂": "-",
    "▁": ".",
}
"""What consoles may lack, as they can show it; names of units keep their meaning."""


def holds_all(stream: TextIO, text: str) -> bool:
    """Whether a stream can print a text as it is."""
    try:
        text.encode(stream.encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def printable(text: str, stream: TextIO) -> str:
    """The text in the characters of a stream: others spelled out where there is a spelling, else replaced by ?."""
    if holds_all(stream, text):
        return text
    encoding = stream.encoding or "ascii"
    shown = []
    for character in text:
        try:
            character.encode(encoding)
            shown.append(character)
        except (UnicodeEncodeError, LookupError):
            shown.append(SPELLED.get(character, "?"))
    return "".join(shown)


def tolerant() -> None:
    """Let stdout and stderr replace what they lack, for what others print on them: a traceback, a bar."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")
