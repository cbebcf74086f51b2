"""Who may speak with a bench: this computer alone, or whoever shares its key.

A bench moves a cart. Away from loopback its packets can be read and made by others, so there they are sealed with a
shared key (see `dpcontrol.rig.packets`), unless the user says that they need not be. The key stands in a file or in the
environment, never on the command line, which every user of a computer can read.
"""

import os
import socket
from ipaddress import ip_address
from pathlib import Path

from dpcontrol.foundation.errors import InputError

KEY_VARIABLE = "DPCONTROL_RIG_KEY"
SHORTEST_KEY = 16
"""Bytes."""
_LONGEST_KEY = 4096


def shared_key(file: Path | None = None) -> bytes:
    """Return the key in `file`, or else in the environment, or b"" where there is none; blanks at its ends are dropped.

    Raises:
        InputError: the file cannot be read, or the key is too short.
    """
    where = f"--key-file {file}" if file else KEY_VARIABLE
    if file is None and KEY_VARIABLE not in os.environ:
        return b""
    try:
        key = (_beginning(file) if file else os.fsencode(os.environ[KEY_VARIABLE])).strip()
    except OSError as error:
        raise InputError(f"{where}: {error.strerror or error}; give a file that holds the key") from error
    if len(key) < SHORTEST_KEY:
        raise InputError(
            f"{where}: a key of {len(key)} bytes is too short; at least {SHORTEST_KEY} are needed, as from "
            "`openssl rand -hex 32`"
        )
    return key


def _beginning(file: Path) -> bytes:
    # Not the whole file, which may be a device without an end.
    with file.open("rb") as stream:
        return stream.read(_LONGEST_KEY)


def resolved(host: str, port: int, *, name: str, family: int = 0) -> tuple[int, tuple]:
    """Return address family and socket address of a host; `name` says in messages where it was given.

    Raises:
        InputError: there is no such host.
    """
    try:
        found = socket.getaddrinfo(host, port, family=family, type=socket.SOCK_DGRAM)[0]
    except (OSError, ValueError, OverflowError) as error:
        # A name that is too long, or that no encoding of host names takes, is a ValueError.
        why = (error.strerror if isinstance(error, OSError) else None) or error
        shown = name if len(name) <= 100 else f"{name[:100]}…"
        raise InputError(f"{shown}: {why}; check the address") from error
    return found[0], found[4]


def check_access(address: tuple, *, name: str, key: bytes, insecure: bool) -> None:
    """Reject an address beyond this computer where neither a key is shared nor the user says that none is needed.

    Raises:
        InputError: it is such an address.
    """
    if not (key or insecure or ip_address(address[0].partition("%")[0]).is_loopback):
        raise InputError(
            f"{name} can be reached from other computers, so both ends need a shared key: give its file with "
            f"--key-file or the key in {KEY_VARIABLE}, or --insecure to let anyone there drive the cart"
        )


def checked_host(host: str, port: int, *, key: bytes, insecure: bool) -> tuple:
    """Return the socket address at which a bench may listen.

    Raises:
        InputError: the host is empty or unknown, or other computers can reach it and there is no key.
    """
    if not host.strip():
        raise InputError("rig: --host is empty; give 127.0.0.1 for this computer alone, 0.0.0.0 for all interfaces")
    _, address = resolved(host, port, name=f"rig: --host {host}", family=socket.AF_INET)
    check_access(address, name=f"rig: --host {host}", key=key, insecure=insecure)
    return address
