"""A live replay: Meshcat's server in a thread of this process.

The thread and its listening socket end with the process.  The server listens at one address, by
default one that only this computer reaches; the process itself sends commands in memory.
"""

from __future__ import annotations

import asyncio
import secrets
import socket
import threading
import warnings
from concurrent.futures import Future
from typing import Any

import numpy as np
import umsgpack
from tornado.httpserver import HTTPServer
from tornado.web import Application

from multiarm.errors import ReplayError
from multiarm.viewer.commands import Command, lowered

with warnings.catch_warnings():  # Meshcat imports a module that pyzmq calls deprecated
    warnings.simplefilter("ignore", DeprecationWarning)
    import meshcat
    from meshcat.servers import zmqserver
    from meshcat.visualizer import ViewerWindow

LOOPBACK = "127.0.0.1"
WILDCARDS = ("0.0.0.0", "::")

# MessagePack extension types by which the viewer knows typed arrays.
KINDS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64")
EXTENSIONS = {kind: 0x11 + k for k, kind in enumerate(KINDS)}


def serve(commands: list[Command], host: str = LOOPBACK, port: int = 0) -> meshcat.Visualizer:
    """Start a Meshcat server, send it the `commands` and return its visualizer.

    It listens at the address `host` of this computer; port 0 takes a free one.

    Raises
    ------
    ReplayError
        The server cannot listen there.
    """
    visualizer = meshcat.Visualizer(window=ReplayWindow(_listening(host, port), host))
    for command in commands:
        visualizer.window.send(_Message(command))
    return visualizer


class ReplayWindow(ViewerWindow):
    """Meshcat's window onto a server in a thread of this process.

    The web server listens at a socket that was bound to the address `host`, which the URL names.
    """

    context = zmqserver.ZMQWebSocketBridge.context  # "inproc" connects within one context only

    def __init__(self, listener: socket.socket, host: str) -> None:
        self._started: Future[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = Future()
        zmq_url = f"inproc://{secrets.token_hex(8)}"
        url = _url(host, listener.getsockname()[1])
        work = self._serve(listener, zmq_url, url)
        self._thread = threading.Thread(target=asyncio.run, args=(work,), daemon=True)
        self._thread.start()
        self._started.result()
        super().__init__(zmq_url, start_server=False, server_args=[])

    def connect_zmq(self) -> None:
        """Connect to the server; Meshcat does so twice, and leaves the first connection open."""
        if hasattr(self, "zmq_socket"):
            self.zmq_socket.close()
        super().connect_zmq()

    def close(self) -> None:
        """End the server before the program ends."""
        loop, ended = self._started.result()
        self.zmq_socket.close()
        loop.call_soon_threadsafe(ended.set)
        self._thread.join()

    async def _serve(self, listener: socket.socket, zmq_url: str, url: str) -> None:
        try:
            bridge, ended = _Bridge(listener, zmq_url, url), asyncio.Event()
        except BaseException as error:
            self._started.set_exception(error)
            raise
        self._started.set_result((asyncio.get_running_loop(), ended))
        await ended.wait()
        await bridge.close()


class _Bridge(zmqserver.ZMQWebSocketBridge):
    """Meshcat's bridge between the program and browsers, listening at the given socket only."""

    def __init__(self, listener: socket.socket, zmq_url: str, url: str) -> None:
        self._listener = listener
        super().__init__(zmq_url=zmq_url, port=listener.getsockname()[1])
        self.web_url = url

    def make_app(self) -> _App:
        """Meshcat's pages and web socket, without their messages on the terminal."""
        viewer = {"path": zmqserver.VIEWER_ROOT, "default_filename": zmqserver.VIEWER_HTML}
        self.app = _App(
            [
                (r"/static/(.*)", zmqserver.StaticFileHandlerNoCache, viewer),
                (r"/", _Feed, {"bridge": self}),
            ],
            log_function=lambda _handler: None,
            listener=self._listener,
        )
        return self.app

    async def close(self) -> None:
        """Close everything that is open."""
        self.app.server.stop()
        await self.app.server.close_all_connections()
        self.zmq_stream.close()


class _App(Application):
    """Listens at the socket of its settings; Meshcat names a port only, of every address."""

    def listen(self, *_: Any, **__: Any) -> HTTPServer:
        self.server = HTTPServer(self)
        self.server.add_socket(self.settings["listener"])
        return self.server


class _Feed(zmqserver.WebSocketHandler):
    """A browser's connection."""

    def open(self, *_: str) -> None:
        self.bridge.websocket_pool.add(self)
        self.bridge.send_scene(self)

    def on_close(self) -> None:
        self.bridge.websocket_pool.discard(self)


def _listening(host: str, port: int) -> socket.socket:
    if not host:  # which would be every address
        raise ReplayError(f"cannot serve the replay at no address; the usual one is {LOOPBACK}")
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listener = socket.create_server((host, port), family=family)
    except (OSError, OverflowError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ReplayError(
            f"cannot serve the replay at {host}, port {port or 'any'}: {reason}; name an address "
            "of this computer and a free port, or write the replay to a file instead"
        ) from error
    listener.setblocking(False)  # as Tornado wants it
    return listener


def _url(host: str, port: int) -> str:
    name = socket.gethostname() if host in WILDCARDS else host
    return f"http://{f'[{name}]' if ':' in name else name}:{port}/static/"


class _Message:
    """A command in the shape that Meshcat's window sends."""

    def __init__(self, command: Command) -> None:
        self.command = command

    def lower(self) -> Command:
        return lowered(self.command, _typed)


def _typed(values: np.ndarray) -> umsgpack.Ext:
    return umsgpack.Ext(EXTENSIONS[values.dtype.name], values.tobytes())
