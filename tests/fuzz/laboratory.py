"""A folder of short logs, plans, recordings and tables made by the program, to be damaged."""

import os
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path

from command_line import dpcontrol

ROOT = Path(__file__).parents[2]
REST = (ROOT / "itineraries/hold-down-down.toml").read_text().replace("seconds = 60.0", "seconds = 0.5")
REST += "noise = 1e-4\ndelay = 1.0\nlag = 0.001\n"
COMMANDS = (
    "run rest.toml --out run.mcap",
    "plan rest.toml --out reference.npz",
    "import --simulated lab --swings 3 --seconds 0.3 --out swings.mcap",
    "campaign rest.toml --runs 2 --workers 1 --out campaign.parquet",
)
SPECIAL = ("folder", "loop", "dangling", "/dev/null", "/dev/zero", "/dev/full", "/proc/self/mem", "empty")


class Laboratory:
    """Contents of files by name; not a dataclass, which hypothesis would print in full."""

    def __init__(self, files: Mapping[str, bytes]) -> None:
        self.files, self.names = files, tuple(files)

    def __repr__(self) -> str:
        return "laboratory"

    def fill(self, folder: Path, words: Iterable[str], changed: Mapping[str, bytes]) -> None:
        """Write the named files, some of them changed, and the special files."""
        (folder / "folder").mkdir()
        (folder / "loop").symlink_to("loop")
        (folder / "dangling").symlink_to("nowhere")
        (folder / "empty").touch()
        text = " ".join(words)
        for name, content in {**self.files, **changed}.items():
            if name.split("/")[0] in text or name in changed or (name == "lab.toml" and "with-model.toml" in text):
                (folder / name).parent.mkdir(exist_ok=True)
                (folder / name).write_bytes(content)


def make_laboratory(folder: Path) -> Laboratory:
    (folder / "rest.toml").write_text(REST)
    (folder / "with-model.toml").write_text(REST.replace('"lab"', '"lab.toml"'))
    for name, source in (("turn", "itineraries/outer-turn"), ("lab", "models/lab"), ("moon", "models/three-body")):
        shutil.copy(ROOT / f"{source}.toml", folder / f"{name}.toml")
    shutil.copy(ROOT / "dpcontrol/recordings/mappings/table.toml", folder / "mapping.toml")
    rows = [f"{k / 1000},{0.3 - 1e-6 * k * k},{0.2 - 1e-6 * k * k},{-2e-3 * k},{-2e-3 * k}" for k in range(120)]
    (folder / "swing.csv").write_text("\n".join(["time,angle_1,angle_2,rate_1,rate_2", *rows]) + "\n")
    before = Path.cwd()
    os.chdir(folder)
    try:
        for line in COMMANDS:
            assert dpcontrol(*line.split()).code == 0, line
    finally:
        os.chdir(before)
    whole = (folder / "run.mcap").read_bytes()
    (folder / "cut.mcap.partial").write_bytes(whole[: len(whole) // 2])
    next((folder / "campaign.parquet").iterdir()).rename(folder / "campaign.parquet" / "0.parquet")
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    return Laboratory({file.relative_to(folder).as_posix(): file.read_bytes() for file in files})
