"""Shared by the tests of the command line."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def shipped_text() -> dict[str, str]:
    """The texts of the itineraries and models of the checkout, by name."""
    return {file.stem: file.read_text() for kind in ("itineraries", "models") for file in (ROOT / kind).glob("*.toml")}
