"""The MCAP log: message layout, writer, reader, recovery."""

from dpcontrol.control.interface import Mode
from dpcontrol.logs.container import partials_of
from dpcontrol.logs.layout import (
    CATCH,
    FLIGHT,
    LAP,
    LEVELS,
    RESUME,
    RETURN,
    Event,
    Stretch,
    control_fields,
    joint_names,
)
from dpcontrol.logs.reader import (
    Comparison,
    Extras,
    RunLog,
    check_replaced,
    compare_messages,
    read_log,
)
from dpcontrol.logs.recovery import Recovery, recover
from dpcontrol.logs.writer import LogWriter, slow_numbers
