"""Where the viewer listens, and the addresses at which people reach it."""

from __future__ import annotations

import errno
import getpass
import ipaddress
import os
import socket
import sys
import threading
import webbrowser
from contextlib import suppress

from ...pipeline import SettingsError

TRIED = 1000  # ports, from the one that was asked for
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER", "WSL_DISTRO_NAME")  # one of them is set where a browser can show something
ELSEWHERE = {socket.AF_INET: "192.0.2.1", socket.AF_INET6: "2001:db8::1"}  # reserved for documentation (RFC 5737, 3849)


def listening(host: str, port: int) -> tuple[str, int]:
    """(numeric address, port) of this machine on which a server can listen: ``host`` resolved, and ``port`` or the next free one.

    Raises SettingsError if ``host`` is not a name or address of this machine, or no port can be used.
    """
    try:
        found = socket.getaddrinfo(host or "", port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise SettingsError(f"--host {host}: no such name or address ({_reason(error)}); use 127.0.0.1, or 0.0.0.0 for all") from error
    why: OSError | None = None
    for family, kind, protocol, _, place in found:
        try:
            with socket.socket(family, kind, protocol) as probe:
                probe.bind((place[0], 0, *place[2:]))  # any port: whether the address is one of ours
            return str(place[0]), _free_port(family, place, host, port)
        except OSError as error:
            why = error
    assert why is not None
    if why.errno == errno.EADDRNOTAVAIL:
        raise SettingsError(f"--host {host}: not an address of this machine; use 127.0.0.1, or 0.0.0.0 for all of its addresses")
    raise SettingsError(f"--host {host}: cannot listen there ({_reason(why)})") from why


def open_page(address: str) -> None:
    """Opens a page in a browser, without waiting for it. Not on a Linux without a screen, for instance over ssh: there the browser that is
    found would be one of text, which takes the terminal."""
    if sys.platform != "linux" or any(os.environ.get(name) for name in SCREENS):
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()


def _free_port(family: int, place: tuple, host: str, port: int) -> int:
    for candidate in range(port, min(port + TRIED, 65536)):
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((place[0], candidate, *place[2:]))
                probe.listen(1)
                return candidate
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise SettingsError(f"--port {candidate}: cannot listen on {host} there ({_reason(error)})") from error
    raise SettingsError(f"--port {port}: this port and those after it are in use; give another")


def addresses(host: str, port: int) -> list[str]:
    """The page's addresses, the one for this machine first. If all of this machine's addresses are listened on, also one for others."""
    with suppress(ValueError):
        number = ipaddress.ip_address(host)
        if number.is_unspecified:
            family = socket.AF_INET if number.version == 4 else socket.AF_INET6
            here = "localhost" if number.version == 4 else "::1"
            return [_page(here, port), _page(_reachable(family), port)]
        if host == "127.0.0.1":
            return [_page("localhost", port)]
    return [_page(host, port)]


def _reachable(family: socket.AddressFamily) -> str:
    """This machine's address in the direction of other networks, or its name if there is none."""
    with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect((ELSEWHERE[family], 9))  # sends nothing
        return str(probe.getsockname()[0])
    return socket.gethostname()


def _page(host: str, port: int) -> str:
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def over_ssh(host: str, port: int) -> str | None:
    """How to reach the page from the machine that is logged in by ssh; None without ssh, or if other machines reach the page anyway."""
    words = os.environ.get("SSH_CONNECTION", "").split()
    page = addresses(host, port)[0].removeprefix("http://")
    if not words or page not in (f"localhost:{port}", f"[::1]:{port}") or len(addresses(host, port)) > 1:
        return None
    server, option = socket.gethostname(), ""
    if len(words) == 4:  # address and port of the client, then of the server
        with suppress(ValueError):
            server = str(ipaddress.ip_address(words[2]))
            option = "" if int(words[3]) == 22 else f"-p {int(words[3])} "
    return f"on your own machine: ssh -L {port}:{page} {option}{_user()}{server}, then open http://localhost:{port} there"


def _user() -> str:
    try:
        return f"{getpass.getuser()}@"
    except (KeyError, OSError, ImportError):  # a container's user without a name
        return ""


def _reason(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)
