"""The pages of the guide, which come with the package."""

import re

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import suggest
from dpcontrol.foundation.version import PACKAGE

GUIDE = PACKAGE / "guide"
"""The folder of the guide's pages; its README.md lists them in reading order."""


def topics() -> dict[str, str]:
    """Return the pages of the guide, with their subjects.

    The pages are in reading order, with a line about each.
    """
    index = (GUIDE / "README.md").read_text(encoding="utf-8")
    return dict(re.findall(r"^- \[([\w-]+)\]\(\1\.md\): (.+)$", index, re.MULTILINE))


def page(topic: str) -> str:
    """Return a page of the guide as Markdown.

    Args:
        topic: name of the page, without .md.

    Raises:
        InputError: the guide has no such page.
    """
    pages = topics()
    if topic not in pages:
        raise InputError(f"the guide has no page {topic!r}; {suggest(topic, pages)}")
    return (GUIDE / f"{topic}.md").read_text(encoding="utf-8")
