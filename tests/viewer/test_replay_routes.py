"""Claims about the ways to a replay: one page, from a temporary file or from a server."""

from __future__ import annotations

import os
import re
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from pathlib import Path
from urllib.parse import unquote, urlsplit

import psutil
import pytest
from commands import multiarm
from page_reader import View
from refusals import refused
from repository import ROOT, SCENES

import multiarm as ma
from multiarm.errors import ReplayError
from multiarm.viewer import browser as browsers
from multiarm.viewer.server import LOOPBACK, listening, url_of

PATIENCE = 300.0  # [s] for another process, which may have to compile the kernels first
DAY = 24 * 3600.0  # [s]


@pytest.fixture(scope="module")
def run(block_system):
    return ma.simulate(block_system, duration=0.05, certificate=False)


@pytest.fixture(scope="module")
def result(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("routes") / "run.h5"
    run.save(path)
    return path


@pytest.fixture
def downloads(monkeypatch, tmp_path):
    """The folder of downloads of a user whose home is empty."""
    folder = tmp_path / "home" / "Downloads"
    folder.mkdir(parents=True)
    monkeypatch.setenv("HOME", str(folder.parent))
    monkeypatch.delenv("XDG_DOWNLOAD_DIR", raising=False)
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return folder


@pytest.fixture
def opened_urls(monkeypatch):
    """What a browser of this user was asked to open."""
    urls = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("webbrowser.open", lambda url: urls.append(url) or True)
    return urls


def assert_is_the_player(view, url):
    """The page has title, legend and a play bar, and plays without a complaint."""
    view.open(url)
    view.page.wait_for_selector("body[data-ready]", timeout=60_000)
    view.page.wait_for_function("viewer.animator.time > 0.01", timeout=60_000)
    assert view.page.inner_text("#about h1") != ""
    assert view.page.locator("#legend .chip").count() > 0
    assert view.page.is_visible("#bar") and view.page.is_visible("#meshcat-pane canvas")
    assert view.complaints == [] and view.requests == [url]


def player_of(page):
    """A page without what is shown."""
    text = page.read_text(encoding="utf-8")
    return re.sub(r'<title>.*?</title>|(?<=id="payload">)[^<]*', "", text)


def path_of(url):
    return Path(unquote(urlsplit(url).path))


# --- from a temporary file ------------------------------------------------------------------------


@pytest.mark.slow
def test_a_replay_opens_the_player(view, run, downloads, opened_urls):
    page = ma.replay(run)
    assert [page.as_uri()] == opened_urls and page.parent == downloads
    assert_is_the_player(view, *opened_urls)


@pytest.mark.slow
@pytest.mark.parametrize("route", ["replay", "run", "modes"])
def test_every_command_opens_a_page_with_that_player(
    run, result, route, downloads, opened_urls, tmp_path
):
    scene = SCENES / "two_ur5_box.yaml"
    words = {
        "replay": ["replay", result],
        "run": ["run", scene, "--replay", "--duration", 0.1, "--out", tmp_path / "run.h5"],
        "modes": ["modes", scene, "--replay", "--amplitude", 0.05],
    }[route]
    called = multiarm(*words)
    assert called.exit_code == 0, called.output
    (page,) = map(path_of, opened_urls)
    assert f"replay written to {page}" in called.stdout and page.parent == downloads
    ours = ma.replay(run, tmp_path / "ours.html", meshes=False)
    assert player_of(page) == player_of(ours)


def test_only_its_owner_reads_the_page(run, downloads, opened_urls):
    page = ma.replay(run, meshes=False)
    assert stat.S_IMODE(page.stat().st_mode) == 0o600
    assert page.stat().st_uid == os.getuid()


@pytest.mark.slow
def test_the_browser_of_the_user_finds_the_page_after_the_program_has_ended(result, downloads):
    """A real browser may be slow to read it."""
    script, seen = downloads / "browser.sh", downloads / "seen.txt"
    script.write_text(f'#!/bin/sh\necho "$1" > "{seen}"\n')
    script.chmod(0o700)
    subprocess.run(
        [sys.executable, "-m", "multiarm", "replay", str(result)], check=True, timeout=PATIENCE,
        env=os.environ | {"PYTHONPATH": str(ROOT), "BROWSER": str(script)}, capture_output=True,
    )  # fmt: skip
    assert path_of(seen.read_text().strip()).read_text(encoding="utf-8").endswith("</html>")


@pytest.mark.parametrize("folder", ["missing", "read only"])
def test_without_a_folder_of_downloads_the_page_is_with_temporary_files(
    downloads, tmp_path, monkeypatch, folder
):
    if folder == "missing":
        downloads.rmdir()
    else:
        monkeypatch.setattr(os, "access", lambda *_: False)
    assert browsers.temporary_page("<html>").parent == tmp_path


def test_pages_of_earlier_days_are_removed_and_nothing_else(downloads):
    old, new = browsers.temporary_page("old"), browsers.temporary_page("new")
    saved, link = downloads / "multiarm-replay-saved.html", downloads / f"link{browsers.SUFFIX}"
    saved.write_text("of the user")
    link.symlink_to(saved)
    for path, age in ((old, DAY + 60.0), (new, DAY - 60.0), (saved, 9 * DAY)):
        os.utime(path, (time.time() - age,) * 2)
    latest = browsers.temporary_page("latest")
    assert set(downloads.iterdir()) == {new, saved, link, latest}


def test_a_full_disk_leaves_no_piece_of_a_page(downloads, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("builtins.open", full)
    with pytest.raises(ReplayError, match=str(downloads)):
        browsers.temporary_page("page")
    assert list(downloads.iterdir()) == []


# --- without a browser ----------------------------------------------------------------------------


@pytest.fixture
def no_display(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)

    def started(url):
        raise AssertionError("a browser for terminals shows no replay")

    monkeypatch.setattr("webbrowser.open", started)


def test_without_a_display_it_is_said_where_the_page_is(run, downloads, no_display):
    with pytest.warns(UserWarning, match="no browser can be opened here") as warned:
        page = ma.replay(run, meshes=False)
    assert page.is_file() and str(page) in str(warned[0].message)
    assert "--port" in str(warned[0].message) and warned[0].filename == __file__


def test_the_command_says_without_a_display_where_the_page_is(result, downloads, no_display):
    called = multiarm("replay", result)
    (page,) = downloads.iterdir()
    assert called.exit_code == 0
    assert f"replay written to {page}" in called.stdout and f"open {page}" in called.stderr


def test_a_browser_that_is_not_wanted_is_not_opened(result, downloads, opened_urls):
    called = multiarm("replay", result, "--no-open")
    (page,) = downloads.iterdir()
    assert (called.exit_code, called.stdout.split()[-1], called.stderr) == (0, str(page), "")
    assert opened_urls == []


# --- from a server --------------------------------------------------------------------------------


class Program:
    """``multiarm replay`` that serves, in a process of its own."""

    def __init__(self, *words: object):
        command = [sys.executable, "-m", "multiarm", "replay", *map(str, words), "--no-open"]
        # Some machines start tests with an ignored SIGINT, which processes inherit.
        self.process = subprocess.Popen(
            command, env=os.environ | {"PYTHONPATH": str(ROOT)}, stderr=subprocess.PIPE, text=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )  # fmt: skip
        lines = (re.match(r"replay at (\S+); Ctrl-C", line) for line in self.process.stderr)
        self.url = next(match[1] for match in lines if match)

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        self.process.stderr.close()


def listening_places(process: psutil.Process) -> set[tuple[str, int]]:
    """Address and port of every TCP socket at which a process or its children listen."""
    family = [process, *process.children(recursive=True)]
    sockets = [item for member in family for item in member.net_connections("tcp")]
    return {tuple(item.laddr) for item in sockets if item.status == psutil.CONN_LISTEN}


def place_of(url: str) -> tuple[str, int]:
    host, port = re.fullmatch(r"http://(.+):(\d+)/", url).groups()
    return host, int(port)


@pytest.mark.slow
def test_only_this_computer_is_served_and_ctrl_c_ends_it(browser, result):
    with Program(result, "--port", 0) as program:
        place = place_of(program.url)
        assert place[0] == "127.0.0.1"
        assert listening_places(psutil.Process(program.process.pid)) == {place}
        page = browser.new_page(viewport={"width": 640, "height": 400})
        assert_is_the_player(View(page), program.url)
        page.close()
        program.process.send_signal(signal.SIGINT)
        assert program.process.wait(PATIENCE) == 0
        assert program.process.stderr.read() == ""
    with socket.create_server(place):  # the port is free again
        pass


def test_another_address_and_port_are_served_when_they_are_named(result, monkeypatch):
    served = []

    def interrupted(server):
        served.append(server.server_address)
        raise KeyboardInterrupt

    monkeypatch.setattr("socketserver.BaseServer.serve_forever", interrupted)
    with socket.create_server(("127.0.0.2", 0)) as free:
        place = free.getsockname()
    called = multiarm("replay", result, "--host", place[0], "--port", place[1], "--no-open")
    assert called.exit_code == 0, called.output
    assert served == [place] and url_of(*place) in called.stderr


def test_a_served_page_is_opened_too_and_no_file_is_written(
    run, downloads, opened_urls, monkeypatch, capsys
):
    def interrupted(self):
        raise KeyboardInterrupt

    monkeypatch.setattr("socketserver.BaseServer.serve_forever", interrupted)
    assert ma.replay(run, host=LOOPBACK, meshes=False) is None
    (url,) = opened_urls
    assert place_of(url)[0] == LOOPBACK and url in capsys.readouterr().err
    assert list(downloads.iterdir()) == []


def test_every_request_gets_the_page_while_other_connections_wait():
    """Browsers open connections ahead of need; those send nothing."""
    page = "<html>\N{GREEK SMALL LETTER MU}</html>"
    with listening(page, LOOPBACK, 0) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            with socket.create_connection(server.server_address):
                for path in ("", "static/"):
                    url = url_of(*server.server_address) + path
                    with urllib.request.urlopen(url, timeout=10.0) as answer:
                        assert answer.read().decode() == page
                        assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.parametrize(
    ("error", "printed"),
    [
        (ConnectionResetError("gone"), False),
        (BrokenPipeError("gone"), False),
        (KeyError("x"), True),
    ],
)
def test_a_browser_that_goes_away_is_no_error_and_a_fault_of_ours_is(error, printed, capsys):
    with listening("<p>page</p>", LOOPBACK, 0) as server:
        try:
            raise error
        except Exception:
            server.handle_error(None, ("127.0.0.1", 1))
    assert (type(error).__name__ in capsys.readouterr().err) == printed


def test_every_address_has_the_name_of_this_computer():
    with listening("page", "0.0.0.0", 0) as server:
        assert server.server_address[0] == "0.0.0.0"
    assert url_of("0.0.0.0", 8000) == f"http://{socket.gethostname()}:8000/"
    assert url_of("::1", 8000) == "http://[::1]:8000/"


@pytest.mark.parametrize("host", ["", "192.0.2.1", "no such host"])
def test_an_address_that_is_not_ours_is_refused(host):
    with refused(ReplayError):
        listening("page", host, 0)


def test_a_port_that_is_taken_is_refused():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ReplayError, match=rf"127\.0\.0\.1, port {port}: "):
            listening("page", LOOPBACK, port)


@pytest.mark.parametrize("options", [{"port": 0}, {"host": LOOPBACK}])
def test_a_page_is_written_or_served_and_not_both(run, tmp_path, options):
    with refused(ReplayError):
        ma.replay(run, tmp_path / "run.html", **options)
    assert not (tmp_path / "run.html").exists()
