"""Claims about files: complete or absent, and never written where somebody else's link leads."""

from __future__ import annotations

import os
import secrets
import stat
import tempfile
from pathlib import Path

import pytest
from mechanics import UR5_POSTURE
from refusals import refused

import multiarm as ma
from multiarm.cli.files import check_targets
from multiarm.errors import MultiarmError
from multiarm.results.files import atomic_file, atomic_output, temporary_name
from multiarm.scene import parse_scene

TEXT = "what was there"


@pytest.fixture
def victim(tmp_path):
    """A file of the user's, elsewhere, that somebody wants to have overwritten."""
    path = tmp_path / "elsewhere" / "precious"
    path.parent.mkdir()
    path.write_text(TEXT)
    return path


@pytest.fixture
def shared(tmp_path):
    """A folder in which others write too."""
    path = tmp_path / "shared"
    path.mkdir()
    return path


@pytest.fixture(scope="module")
def trajectory(block_system):
    return ma.simulate(block_system, duration=0.02, certificate=False)


def test_a_run_takes_the_place_of_a_link_and_does_not_follow_it(block_system, shared, victim):
    target = shared / "run.h5"
    (shared / ".run.h5.part").symlink_to(victim)
    ma.simulate(block_system, duration=0.01, certificate=False, out=target).close()
    assert list(shared.iterdir()) == [target]
    assert victim.read_text() == TEXT


WRITERS = {
    "json": lambda trajectory, path: _write_text(path),
    "save": lambda trajectory, path: trajectory.save(path),
    "replay": lambda trajectory, path: ma.replay(trajectory, path, meshes=False),
    "report": lambda trajectory, path: ma.report(trajectory, path),
    "check": lambda trajectory, path: check_targets({"--out": path}),
}


def _write_text(path):
    with atomic_output(path, "--json") as partial:
        partial.write_text("new")


@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.usefixtures("without_figures")
def test_links_under_names_that_can_be_guessed_are_not_touched(trajectory, shared, victim, writer):
    target = shared / "result"
    endings = ("part", "partial", "saving", "tmp", f"{os.getpid()}.part")
    planted = {shared / f".{target.name}.{ending}" for ending in endings}
    for link in planted:
        link.symlink_to(victim)
    WRITERS[writer](trajectory, target)
    assert set(shared.iterdir()) - {target} == planted
    assert all(link.is_symlink() for link in planted)
    assert victim.read_text() == TEXT


@pytest.mark.parametrize("writer", [name for name in WRITERS if name != "save"])
@pytest.mark.parametrize("there", [True, False])
@pytest.mark.usefixtures("without_figures")
def test_a_link_that_comes_in_between_is_not_followed(
    trajectory, shared, victim, writer, there, monkeypatch
):
    """Somebody guesses the name, and puts a link there after it was found to be free."""
    monkeypatch.setattr(secrets, "token_hex", lambda _size: "guessed")
    monkeypatch.setattr(Path, "unlink", lambda *_, **__: None)
    if not there:
        os.unlink(victim)
    target = shared / "result"
    temporary_name(target).symlink_to(victim)
    with refused(MultiarmError, str(target)):
        WRITERS[writer](trajectory, target)
    assert not target.exists()
    assert victim.exists() is there
    assert not there or victim.read_text() == TEXT


def test_two_temporary_names_differ(tmp_path):
    assert temporary_name(tmp_path / "a") != temporary_name(tmp_path / "a")


def test_a_file_appears_when_it_is_complete_with_the_modes_that_the_user_wants(tmp_path):
    target, before = tmp_path / "a", os.umask(0o027)
    try:
        with atomic_file(target) as partial:
            partial.write_text("new")
            assert not target.exists()
    finally:
        os.umask(before)
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    with pytest.raises(KeyError), atomic_file(target) as partial:
        raise KeyError
    assert list(tmp_path.iterdir()) == [target]
    assert target.read_text() == "new"


def test_a_hand_of_a_scene_needs_no_file(shared, victim, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(shared))
    planted = shared / f"multiarm-hands-{os.getuid()}"
    planted.symlink_to(victim.parent)
    hand = {"fingers": {"tips": [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0]]}, "mount": "tool0"}
    arm = {"robot": "ur5", "tip": "corner", "tool": hand, "posture": UR5_POSTURE}
    body = {"shape": {"box": [0.3, 0.2, 0.2]}, "mass": 2.0, "pose": {"xyz": [0.6, 0, 0.5]}}
    joints = [{"arm": "arm", "kind": "weld"}]
    ma.compile_system(parse_scene({"object": body, "arms": {"arm": arm}, "joints": joints}))
    assert list(shared.iterdir()) == [planted]
    assert list(victim.parent.iterdir()) == [victim]
