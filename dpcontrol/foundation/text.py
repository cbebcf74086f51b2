"""Text of users, made safe to print: what names, titles and files say must not steer a terminal."""

import re

_CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")
"""Control characters but tab and newline, and those that reorder a line."""


def printable(text: str, *, json: bool = False) -> str:
    """Return text with control characters written out, as in \\x1b; json: the text is JSON, which writes \\u001b."""

    def written_out(found: re.Match[str]) -> str:
        return f"\\u{ord(found[0]):04x}" if json else found[0].encode("unicode_escape").decode()

    return _CONTROLS.sub(written_out, text)
