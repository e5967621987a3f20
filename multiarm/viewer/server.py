"""Serve a page to browsers until Ctrl-C: for a browser on another computer, behind a tunnel."""

from __future__ import annotations

import socket
import sys
from http.server import BaseHTTPRequestHandler
from socketserver import ThreadingTCPServer
from typing import Any

from multiarm.errors import ReplayError
from multiarm.terminal.console import messages
from multiarm.viewer.browser import open_in_browser

LOOPBACK = "127.0.0.1"
WILDCARDS = ("0.0.0.0", "::")


def serve(page: str, host: str = LOOPBACK, port: int = 0, open_browser: bool = False) -> None:
    """Serve a page at an address of this computer, say where on stderr, and return at Ctrl-C.

    Port 0 takes a free one.

    Raises
    ------
    ReplayError
        Nothing can listen there.
    """
    with listening(page, host, port) as server:
        url = url_of(host, server.server_address[1])
        try:
            messages().print(f"replay at {url}; Ctrl-C ends it", soft_wrap=True)
            if open_browser:
                open_in_browser(url)
            server.serve_forever()
        except KeyboardInterrupt:
            return


class PageServer(ThreadingTCPServer):
    """Answers every request with one page.

    Each connection has a thread, since browsers open some that they do not use.
    """

    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, page: str, host: str, port: int) -> None:
        self.page = page.encode()
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        super().__init__((host, port), _PageHandler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print an error, but not that a browser has gone away."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)


class _PageHandler(BaseHTTPRequestHandler):
    timeout = 60.0  # [s] for a connection that is not used
    server: PageServer

    def do_GET(self) -> None:
        """Send the page, whatever its address."""
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(self.server.page)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(self.server.page)

    def log_message(self, *_: object) -> None:
        """Keep requests off the terminal."""


def listening(page: str, host: str, port: int) -> PageServer:
    """Return a server of a page, which listens at an address of this computer.

    Raises
    ------
    ReplayError
        Nothing can listen there.
    """
    if not host:  # which would be every address
        raise ReplayError(f"cannot serve the replay at no address; the usual one is {LOOPBACK}")
    try:
        return PageServer(page, host, port)
    except (OSError, OverflowError, TypeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ReplayError(
            f"cannot serve the replay at {host}, port {port or 'any'}: {reason}; name an address "
            "of this computer and a free port, or write the replay to a file instead"
        ) from error


def url_of(host: str, port: int) -> str:
    """Return the page's address; a server at all addresses is found by this computer's name."""
    name = socket.gethostname() if host in WILDCARDS else host
    return f"http://{f'[{name}]' if ':' in name else name}:{port}/"
