"""Claims about the server of a live replay: who reaches it, and that it ends with its program."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request
import uuid

import psutil
import pytest
from repository import ROOT

import multiarm as ma
from multiarm.errors import ReplayError
from multiarm.viewer.server import serve

MARK = "MULTIARM_TEST_OF_A_PROGRAM"
PATIENCE = 300.0  # [s] for another process, which may have to compile the kernels first


@pytest.fixture(scope="module")
def result(block_system, tmp_path_factory):
    path = tmp_path_factory.mktemp("live") / "run.h5"
    ma.simulate(block_system, duration=0.02, certificate=False, out=path)
    return path


class Program:
    """``multiarm replay`` in a process of its own, known by a mark in its environment."""

    def __init__(self, *words: object):
        self.mark = str(uuid.uuid4())
        environment = os.environ | {"PYTHONPATH": str(ROOT), MARK: self.mark}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "multiarm", "replay", *map(str, words), "--no-open"],
            env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        found = (re.match(r"replay at (\S+);", line) for line in self.process.stderr)
        self.url = next(match[1] for match in found if match)

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self.processes():
            process.kill()
        self.process.wait()
        self.process.stderr.close()

    def processes(self) -> list[psutil.Process]:
        """Every process that has the mark: the program and whatever it has started."""
        return [process for process in psutil.process_iter() if self._marked(process)]

    def _marked(self, process: psutil.Process) -> bool:
        try:
            return process.environ().get(MARK) == self.mark
        except psutil.Error:  # it has just ended, or is another user's
            return False


def listening(processes: list[psutil.Process]) -> set[tuple[str, int]]:
    """Address and port of every TCP socket at which one of the processes listens."""
    found = [place for process in processes for place in process.net_connections("tcp")]
    return {tuple(place.laddr) for place in found if place.status == psutil.CONN_LISTEN}


def taken(place: tuple[str, int]) -> bool:
    """Whether somebody, whoever it is, listens there."""
    with socket.socket() as own:
        own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            own.bind(place)
        except OSError:
            return True
    return False


def place_of(url: str) -> tuple[str, int]:
    host, port = re.fullmatch(r"http://(.+):(\d+)/static/", url).groups()
    return host, int(port)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["SIGTERM", "SIGHUP", "SIGINT", "SIGKILL"])
def test_only_this_computer_is_served_and_nothing_outlives_the_program(result, how):
    with Program(result) as program:
        here = place_of(program.url)
        assert here[0] == "127.0.0.1"
        assert listening(program.processes()) == {here}
        with urllib.request.urlopen(program.url, timeout=PATIENCE) as answer:
            assert b"MeshCat" in answer.read()
        program.process.send_signal(signal.Signals[how])
        program.process.wait(PATIENCE)
        assert program.processes() == []
        assert not taken(here)


@pytest.mark.slow
def test_another_address_and_port_are_served_when_they_are_named(result):
    with socket.create_server(("127.0.0.2", 0)) as free:
        port = free.getsockname()[1]
    with Program(result, "--host", "127.0.0.2", "--port", port) as program:
        assert program.url == f"http://127.0.0.2:{port}/static/"
        assert listening(program.processes()) == {("127.0.0.2", port)}


def test_every_address_has_the_name_of_this_computer():
    window = serve([], "0.0.0.0").window
    try:
        assert place_of(window.web_url)[0] == socket.gethostname()
        assert ("0.0.0.0", place_of(window.web_url)[1]) in listening([psutil.Process()])
    finally:
        window.close()


def test_a_closed_window_serves_no_more():
    before = listening([psutil.Process()])
    window = serve([]).window
    assert listening([psutil.Process()]) - before == {place_of(window.web_url)}
    window.close()
    assert listening([psutil.Process()]) == before


@pytest.mark.parametrize("host", ["", "192.0.2.1", "no such host"])
def test_an_address_that_is_not_ours_is_refused(host):
    with pytest.raises(ReplayError, match="cannot serve the replay at"):
        serve([], host)


def test_a_port_that_is_taken_is_refused():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(
            ReplayError, match=rf"127\.0\.0\.1, port {port}: .*in use.*; name an address"
        ):
            serve([], port=port)
