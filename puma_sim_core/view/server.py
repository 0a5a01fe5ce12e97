# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The server of a page in the browser: viser, on this machine alone unless another address is asked for."""

from __future__ import annotations

import contextlib
import io
import socket
from collections.abc import Iterator
from typing import Any

from puma_sim_core.errors import ParameterError, PumaSimError

HOST = "127.0.0.1"
#: the first port that is tried where none is asked for
PORT = 8080


@contextlib.contextmanager
def serving(host: str = HOST, port: int | None = None, label: str = "puma-sim") -> Iterator[Any]:
    """A viser server until the block ends.

    port : None for the first free one from 8080 on, 0 for any; label : above the controls.

    Raises
    ------
    PumaSimError : viser is not installed.
    ParameterError : the port is taken, or the address is none of this machine.
    """
    viser = load_viser()
    _check_free(host, port or 0)
    # it writes its own lines to standard output, about sockets
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host, PORT if port is None else port, label, verbose=False)
    try:
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def load_viser() -> Any:
    """The module; raises PumaSimError where it is not installed."""
    try:
        import viser  # optional: the extra `view`
    except ImportError as error:
        what, expected = f"viser cannot be imported ({error})", "pip install 'puma_sim_ros[view]'"
        raise PumaSimError(what, where="view", expected=expected) from None
    return viser


def address(server: Any) -> str:
    """Where a browser on this machine finds the page."""
    host = server.get_host()
    return f"http://{HOST if host in ('0.0.0.0', '::') else host}:{server.get_port()}"


def _check_free(host: str, port: int) -> None:
    """Bind and let go: viser itself would try a thousand other ports."""
    if not 0 <= port <= 65535:
        raise ParameterError(f"{port}", where="port", expected="a number from 0 to 65535")
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(place)
    except OSError as error:
        where, expected = f"{host}, port {port}", "a free port, and an address of this machine"
        raise ParameterError(f"cannot be listened on ({error.strerror})", where=where, expected=expected) from None
