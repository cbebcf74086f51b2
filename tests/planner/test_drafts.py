"""The itinerary's text can be edited by clicks and by typing, and errors have line numbers."""

import pytest

from dpcontrol.planner.draft import first_text, read_draft

FIRST = first_text("lab")


@pytest.mark.parametrize(
    ("before", "after", "line"),
    [
        ("energy = 0.2", "energy = ", 3),
        ("energy = 0.2", "energy = nan", 3),
        ('model  = "lab"', 'model  = "lob"', 2),
        ("walk   = []", 'walk   = ["sideways"]', 4),
        ("wraps  = []", "wraps  = [1, 2, 3]", 5),
        ("initial_error = 0.02", "initial_eror = 0.02", 11),
    ],
)
def test_an_error_is_reported_with_its_line(before: str, after: str, line: int) -> None:
    text = FIRST if "wraps" not in after else FIRST.replace("walk   = []", 'walk   = ["down-up +"]')
    draft = read_draft(text.replace(before, after))
    assert draft.mistake is not None
    assert draft.mistake.line == line, draft.mistake
    assert draft.itinerary is None
