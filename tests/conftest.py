"""Shared fixtures: compiled systems (compiled once; tests never change them), browsers, randomness.

``--quick`` runs one case of each test that is not marked ``slow``: what takes a third of a second
or more, such as browsers, clusters and whole commands.  Each file keeps its quickest tests.
"""

from __future__ import annotations

import os
import signal

import pytest
from hypothesis import settings

# NumPy reads it when it is imported. Each worker has one processor, and a second thread of the
# linear algebra costs many times what it saves on matrices of some ten rows.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# The first example of a test may have to compile kernels.
settings.register_profile("multiarm", deadline=None, max_examples=40)
settings.load_profile("multiarm")


# Where the shell ignores Ctrl-C (`nohup`, jobs in the background), this process and those that it
# starts would ignore it as well; tests send it to themselves and to others.
signal.signal(signal.SIGINT, signal.default_int_handler)

LONGEST_TEST = 1800
"""[s] after which a test fails, so that one that waits for ever does not hold up the others; on a
busy computer with empty caches some take minutes."""


def pytest_addoption(parser):
    parser.addoption("--quick", action="store_true", help="one case of each test that is not slow")
    parser.addoption("--write-messages", action="store_true", help="write the wording of errors")


def pytest_configure(config):
    if config.getoption("--write-messages"):
        os.environ["MULTIARM_WRITE_MESSAGES"] = "1"


def pytest_sessionfinish(session):
    if session.config.getoption("--write-messages"):
        from refusals import write_seen

        tests = {item.nodeid.removeprefix("tests/") for item in session.items}
        config = session.config
        some = any("::" in path for path in config.args) or config.getoption("--quick")
        if not (some or config.option.keyword or config.option.markexpr):
            tests |= {test.partition("::")[0] for test in tests}  # and those that are gone
        write_seen(tests)


def pytest_collection_modifyitems(config, items):
    if not config.getoption("--quick"):
        return
    chosen, left = {}, []
    for item in items:
        test = item.nodeid.partition("[")[0]
        if item.get_closest_marker("slow") or test in chosen:
            left.append(item)
        else:
            chosen[test] = item
    config.hook.pytest_deselected(items=left)
    items[:] = chosen.values()


@pytest.fixture(autouse=True)
def limit():
    """A test ends, with a traceback of where it waits."""

    def end(number, frame):
        raise TimeoutError(f"the test has not ended after {LONGEST_TEST} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(LONGEST_TEST)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def rng():
    """Random numbers, the same in every run of a test."""
    import numpy as np

    return np.random.default_rng(20240607)


@pytest.fixture(scope="session")
def block_system():
    """The worked example of two arms and seven fingertips, constant torques."""
    from mechanics import two_arm_block

    import multiarm as ma

    return ma.compile_system(two_arm_block())


@pytest.fixture(scope="session")
def free_block_system():
    """The worked example without torques."""
    from mechanics import two_arm_block

    import multiarm as ma

    return ma.compile_system(two_arm_block(torques=False))


@pytest.fixture(scope="session")
def ur5_system():
    """Two UR5s hold a box: one welded to it, one by a ball joint."""
    from mechanics import ur5_pair

    import multiarm as ma

    return ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "ball"}))


@pytest.fixture(scope="session")
def welded_ur5_system():
    """Two UR5s welded to a box."""
    from mechanics import ur5_pair

    import multiarm as ma

    return ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "weld"}))


@pytest.fixture
def without_figures(monkeypatch):
    """Reports of runs have no figures, which take most of their time."""
    monkeypatch.setattr("multiarm.plots.figures", lambda trajectory: {})


@pytest.fixture(scope="session")
def browser():
    """Chromium without a window, started once."""
    from page_reader import FLAGS, chromium
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def view(browser):
    """A page without a network."""
    from page_reader import FEW_FRAMES, View

    page = browser.new_page(viewport={"width": 640, "height": 400}, offline=True)
    page.add_init_script(FEW_FRAMES)
    yield View(page)
    page.close()
