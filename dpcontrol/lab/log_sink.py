"""A log as the loop's sink: blocks of ticks and events, written as they come."""

from dpcontrol.lab.result import Ticks
from dpcontrol.logs import LogWriter


class LogSink:
    """Hands the loop's ticks and events to a log's writer."""

    def __init__(self, writer: LogWriter) -> None:
        self._writer = writer

    def ticks(self, rows: Ticks) -> None:
        """Write the next ticks."""
        self._writer.ticks(
            rows.times,
            measured=rows.measured,
            estimate=rows.estimates,
            reference=rows.references,
            truth=rows.truth,
            control=rows.control,
        )

    def event(self, time_s: float, level: str, name: str, text: str) -> None:
        """Write one event."""
        self._writer.event(time_s, level, name, text)
