"""What `dpcontrol bench` draws, saves and prints: a page of parts, each a diagram, with words on how to read it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

if TYPE_CHECKING:
    from matplotlib.figure import Figure

READING_LINES = 3


@dataclass(frozen=True)
class TextTable:
    """A table for people: title, heads of the columns, rows of text; notes follow it, a line each."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()


class Part(Protocol):
    """A diagram of a page."""

    def complaints(self) -> tuple[str, ...]:
        """Return what is not as it should be, a sentence each."""
        ...

    def document(self) -> dict[str, Any]:
        """Return everything in JSON's terms."""
        ...

    def table(self) -> TextTable:
        """Return what is shown to people in the terminal."""
        ...


@dataclass(frozen=True)
class Page:
    """A page: its name on the command line and of its files, title, three lines on how to read it, what was chosen.

    PARTS: the field that holds its diagrams, and their name in JSON.

    Raises:
        ValueError: the reading is not of three lines.
    """

    PARTS: ClassVar[str]

    name: str
    title: str
    reading: tuple[str, str, str]
    chosen: str

    def __post_init__(self) -> None:
        if len(self.reading) != READING_LINES:
            raise ValueError(f"{self.name}: {len(self.reading)} lines on how to read it; write {READING_LINES}")

    @property
    def parts(self) -> tuple[Part, ...]:
        """The diagrams."""
        return getattr(self, self.PARTS)

    @property
    def complaints(self) -> tuple[str, ...]:
        """What is not as it should be, a sentence each; empty where all is."""
        return tuple(text for part in self.parts for text in part.complaints())

    def document(self) -> dict[str, Any]:
        """Return the page in JSON's terms."""
        return {
            "name": self.name,
            "title": self.title,
            "reading": list(self.reading),
            "chosen": self.chosen,
            "complaints": list(self.complaints),
            self.PARTS: [part.document() for part in self.parts],
        }

    def figure(self) -> "Figure":
        """Return the picture."""
        raise NotImplementedError

    def tables(self) -> tuple[TextTable, ...]:
        """Return each part's table."""
        return tuple(part.table() for part in self.parts)
