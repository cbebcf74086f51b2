"""The pages of the guide, which come with the package."""

import re
from typing import Any

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import suggest
from dpcontrol.foundation.version import PACKAGE

GUIDE = PACKAGE / "guide"
"""The folder of the guide's pages; its README.md lists them in reading order."""


def topics() -> dict[str, str]:
    """Return the pages of the guide in reading order, with a line about the subject of each."""
    index = (GUIDE / "README.md").read_text(encoding="utf-8")
    return dict(re.findall(r"^- \[([\w-]+)\]\(\1\.md\): (.+)$", index, re.MULTILINE))


class GuidePage(str):
    """A page of the guide in Markdown.

    Attributes:
        topic: name of the page, None for the list of pages.
        topics: all pages by name, with a line about each.
    """

    topic: str | None
    topics: dict[str, str]

    def document(self) -> dict[str, Any]:
        """Return the page and the list of pages as JSON values."""
        page = {} if self.topic is None else {"topic": self.topic, "text": str(self)}
        return {**page, "topics": [{"topic": name, "about": about} for name, about in self.topics.items()]}


def page(topic: str | None = None) -> GuidePage:
    """Return a page of the guide.

    Args:
        topic: name of the page, without .md, or None for the list of pages.

    Raises:
        InputError: the guide has no such page.
    """
    pages = topics()
    if topic is not None and topic not in pages:
        raise InputError(f"the guide has no page {topic!r}; {suggest(topic, pages)}")
    text = GuidePage((GUIDE / f"{topic or 'README'}.md").read_text(encoding="utf-8"))
    text.topic, text.topics = topic, pages
    return text
