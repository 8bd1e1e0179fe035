"""Notes every name look-up and connection of Python: imported as `sitecustomize` by every process of a test.

One line each, appended to the file that POSEFUSE_TEST_NETWORK_LOG names; what stays on this machine is left out.
"""

import os
import sys

LOG = os.environ.get("POSEFUSE_TEST_NETWORK_LOG", "")
EVENTS = ("socket.getaddrinfo", "socket.gethostbyname", "socket.gethostbyaddr", "socket.connect", "socket.sendto")
HERE = ("127.", "::1", "localhost", "0.0.0.0", "None")


def host_of(event: str, arguments: tuple) -> str:
    """The other end; empty for a socket of this machine alone."""
    if event in ("socket.connect", "socket.sendto"):
        address = arguments[1]
        # a path for sockets of this machine
        return str(address[0]) if isinstance(address, tuple) else ""
    return str(arguments[0])


def note(event: str, arguments: tuple) -> None:
    """An audit hook."""
    if event in EVENTS and (host := host_of(event, arguments)) and not host.startswith(HERE):
        with open(LOG, "a", encoding="utf-8") as log:  # noqa: PTH123  nothing is imported by the hook
            log.write(f"{event} {host} {' '.join(sys.argv)}\n")


if LOG:
    sys.addaudithook(note)
