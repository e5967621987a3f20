"""Claims about hostile inputs: whatever a program is given, it has one clear answer, and soon.

These are representatives; `tests/support/fuzz.py` looks for others every night.
"""

from __future__ import annotations

import math
import os

import h5py
import numpy as np
import pytest
from hostile_inputs import (
    CORPUS,
    PART,
    SCENE,
    everything_of_run,
    everything_of_sweep,
    of_file,
    put,
    shortcomings,
    stored_run,
    stored_sweep,
    system,
)

import multiarm as ma


@pytest.mark.parametrize(
    "name",
    [
        "laughs.yaml",
        "invalid_utf_8.yaml",
        "recursive_key.yaml",
        "key_twice.yaml",
        "python_apply.yaml",
        "tag_int_minus.yaml",
        "mass_nan.yaml",
        "entities.urdf",
        "cycle.urdf",
        "axis_nan.urdf",
        "4e9_triangles.stl",
        "obj_index.obj",
    ],
)
def test_a_hostile_file_is_refused_in_one_message(name, tmp_path):
    path = CORPUS / "refused" / name
    answer = of_file(tmp_path, path.suffix, path.read_bytes())
    assert shortcomings(tmp_path, answer, refused=True) == []


def test_nesting_without_end_is_refused_in_one_message(tmp_path):
    assert shortcomings(tmp_path, of_file(tmp_path, ".yaml", b"[" * 100_000), refused=True) == []


def _huge(file):
    del file["time"]
    file.create_dataset("time", (2**50,), "f8", chunks=(512,))
    file["progress"][0] = 2**50


def _linked(file):
    del file["time"]
    file["time"] = h5py.ExternalLink("/etc/passwd", "/time")


def _not_a_number(file):
    file["object/position"][3, 1] = math.nan


@pytest.mark.parametrize("change", [_huge, _linked, _not_a_number])
def test_a_damaged_run_is_refused_in_one_message(change, tmp_path):
    path = put(tmp_path / "stored.h5", stored_run())
    with h5py.File(path, "r+") as file:
        change(file)
    assert shortcomings(tmp_path, lambda: everything_of_run(path), refused=True) == []


@pytest.mark.parametrize("content", [b"hello", b"\0" * 4096])
def test_a_damaged_sweep_is_refused_in_one_message(content, tmp_path):
    for name, data in stored_sweep().items():
        put(tmp_path / "s.sweep" / name, content if name == PART else data)
    answer = lambda: everything_of_sweep(tmp_path / "s.sweep")  # noqa: E731
    assert shortcomings(tmp_path, answer, refused=True) == []


@pytest.mark.parametrize("path", ["/dev/zero", "pipe"])
def test_a_file_without_end_is_refused_in_one_message(path, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    assert shortcomings(tmp_path, ["check", path], refused=True) == []


@pytest.mark.parametrize(
    "call",
    [
        lambda: ma.simulate(system(), duration=math.nan),
        lambda: ma.simulate(system(), integrator="rk4", step=1e-300),
        lambda: ma.evaluate(system(), 0.0, np.zeros(11)),
        lambda: system().state(joint_positions={"left": np.zeros((2, 2))}),
    ],
    ids=["duration", "step", "state", "posture"],
)
def test_an_argument_that_makes_no_sense_is_refused_in_one_message(call, tmp_path):
    assert shortcomings(tmp_path, call, refused=True) == []


def test_an_input_that_is_accepted_or_answered_raw_is_found(tmp_path):
    """The judge of the tests above bites."""
    assert shortcomings(tmp_path, of_file(tmp_path, ".yaml", SCENE.encode()), True) == ["accepted"]
    (fault,) = shortcomings(tmp_path, lambda: int("x"))
    assert fault.startswith("traceback: ValueError")
