"""The version of the package, and the folder in which it is installed."""

from pathlib import Path

VERSION = "0.3.0"
__version__ = VERSION
PROGRAM = f"dpcontrol {VERSION}"
"""Name of the program in files that it writes."""
PACKAGE = Path(__file__).parent.parent
"""Folder of the package."""
