"""The MCAP log: message layout, writer, reader."""

from dpcontrol.control.interface import Mode
from dpcontrol.logs.layout import LEVELS, control_fields, joint_names
from dpcontrol.logs.reader import Event, RunLog, read_log
from dpcontrol.logs.writer import LogWriter

__all__ = [
    "LEVELS",
    "Event",
    "LogWriter",
    "Mode",
    "RunLog",
    "control_fields",
    "joint_names",
    "read_log",
]
