"""A rig at the other end of a serial line, such as the USB port of a microcontroller.

The packets are those of `dpcontrol.rig.packets`. A frame is a packet with its CRC-32 (little-endian), encoded by COBS
(Cheshire and Baker 1999), which leaves no zero byte in it, between two zero bytes. A frame with another CRC counts as a
rejected packet. At 1 Mbit/s the reading of two arms takes 0.8 ms and a command 0.4 ms, so both fit in a period of 1 ms.
"""

import zlib
from typing import Any

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.parts import Later
from dpcontrol.rig.client import PacketRig

serial, cobs = Later("serial"), Later("cobs.cobs")
SERIAL = "serial://"


def parse_line(text: str) -> tuple[str, int]:
    """Return device and baud rate of `serial://PATH?baud=RATE`; the rate is 1,000,000 by default.

    Args:
        text: address of a bench.

    Raises:
        InputError: the text has another form.
    """
    path, _, rate = text.removeprefix(SERIAL).partition("?baud=")
    baud = int(rate) if rate.isdecimal() else 0 if rate else 1_000_000
    if not (text.startswith(SERIAL) and path and 300 <= baud <= 20_000_000):
        raise InputError(
            f"rig {text!r}: must be serial://PATH or serial://PATH?baud=RATE, 300 to 20,000,000 bit/s, such as "
            "serial:///dev/ttyACM0"
        )
    return path, baud


def framed(packet: bytes) -> bytes:
    """Return the frame of a packet, whose begin and end a receiver finds in the stream of bytes.

    Args:
        packet: encoded packet.
    """
    return b"\0" + cobs.encode(packet + zlib.crc32(packet).to_bytes(4, "little")) + b"\0"


def unframed(frame: bytes) -> bytes:
    """Return the packet of a frame, or b"" if the frame is damaged.

    Args:
        frame: bytes between two zero bytes.
    """
    try:
        data = cobs.decode(frame)
    except cobs.DecodeError:
        return b""
    packet, check = data[:-4], data[-4:]
    return packet if zlib.crc32(packet).to_bytes(4, "little") == check else b""


class SerialLine:
    """Channel of packets over a serial device, with the interface of a socket that `PacketRig` uses.

    Args:
        path: device, such as /dev/ttyACM0.
        baud: rate, bit/s.

    Raises:
        InputError: the device cannot be opened, or another program uses it.
    """

    def __init__(self, path: str, baud: int) -> None:
        try:
            self._port = serial.Serial(path, baud, timeout=0, write_timeout=0, exclusive=True)
        except (OSError, ValueError) as error:
            raise InputError(
                f"rig {SERIAL}{path}: cannot open the serial line: {error}; check the path, its permissions, and that "
                "no other program uses it"
            ) from error
        # Received bytes of frames that were not returned yet, the last of which may be incomplete.
        self._waiting = b""

    def send(self, data: bytes) -> None:
        """Send a packet in its frame.

        Args:
            data: encoded packet.
        """
        self._port.write(framed(data))

    def recv(self, most: int) -> bytes:
        """Return the next packet; b"" for a damaged one.

        Args:
            most: longest packet; bytes without a frame beyond it are dropped.

        Raises:
            BlockingIOError: no whole packet has arrived.
        """
        if b"\0" not in self._waiting:
            self._waiting += self._port.read(most)
        while self._waiting:
            frame, end, following = self._waiting.partition(b"\0")
            if not end:
                break
            self._waiting = following
            if frame:
                return unframed(frame)
        self._waiting = self._waiting[:most]
        raise BlockingIOError

    def fileno(self) -> int:
        """Return the file descriptor, by which `select` waits for bytes."""
        return self._port.fileno()

    def close(self) -> None:
        """Close the device."""
        self._port.close()


class SerialRig(PacketRig):
    """A bench over a serial line as a `Rig` and context manager.

    Args:
        address: serial://PATH?baud=RATE.
        **settings: further arguments of `PacketRig`.

    Raises:
        InputError: the address is invalid, the line cannot be opened, no bench responds, or the key is wrong.
    """

    def __init__(self, address: str, **settings: Any) -> None:
        super().__init__(SerialLine(*parse_line(address)), address, **settings)
