"""The commit that this package runs from, for logs and charts."""

import subprocess
from pathlib import Path

import dpcontrol


def commit() -> str:
    """Return the commit of the checkout that this package runs from, or "" for an installed one."""
    root = Path(dpcontrol.__file__).parent.parent
    if not (root / ".git").exists():
        return ""
    command = ["git", "-C", str(root), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=5, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
