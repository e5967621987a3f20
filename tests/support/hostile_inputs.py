"""Inputs that nobody should write: how they reach the program, and what is demanded of its answer.

An answer is one clear message, or a result all of whose numbers are finite; and it comes soon.
"""

from __future__ import annotations

import io
import os
import re
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import sample_run
import yaml
from commands import multiarm
from repository import DATA, ROOT

import multiarm as ma
from multiarm.errors import MultiarmError
from multiarm.results.sinks import Hdf5Sink, provenance

LONGEST = 4000  # characters of a message
PATIENCE = 60  # [s] for one answer; the kernels may have to be compiled first
MEMORY = 4 << 30  # [bytes] of address space beyond what the process has
RAW = re.compile(r"Traceback|[a-z]Warning\b|0x[0-9a-f]{8}|For further information|pydantic|yaml\.")
CORPUS = DATA / "corpus"

Answer = list[Any] | Callable[[], Any]
"""The words of a command, or a call of the API."""

SCENE = """\
name: two arms hold a disc
gravity: [0.5, -9.81, 0.0]
object:
  shape: {cylinder: {radius: 0.2, height: 0.05}}
  mass: 3.0
arms:
  left: {urdf: arm.urdf, tip: tip, base: {xyz: [-0.8, 0, 0]}, posture: [0.7, -1.2]}
  right: {urdf: arm.urdf, tip: tip, base: {xyz: [0.8, 0, 0], rpy: [0, 0, 3.141592653589793]},
    posture: [0.7, -1.2]}
joints:
  - {arm: left, kind: ball}
  - {arm: right, kind: ball}
effects: {joint_damping: 0.5}
run: {duration: 0.02, accuracy: 0.001, output_step: 0.01}
"""
SWEEP = """\
over:
  object.mass: {linspace: [1, 2, 2]}
  effects.joint_damping: [0.1, 1]
keep: [energy_balance]
seed: 3
run: {duration: 0.01, accuracy: 0.001}
"""
STORED = """\
name: a stored scene
object: {shape: {box: [1, 1, 1]}, mass: 2}
arms: {left: {robot: textbook_6r, tip: tool}, right: {robot: planar_3r, tip: tip}}
joints: [{arm: left, kind: weld}, {arm: right, kind: ball}]
"""
URDF = (ROOT / "robots" / "planar_2r" / "planar_2r.urdf").read_text(encoding="utf-8")
PART = "parts/0.parquet"


# --- how an input reaches the program ------------------------------------------------------------


def put(path: Path, content: str | bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(
        content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    )
    return path


def scene_file(folder: Path, text: str | bytes = SCENE, urdf: str | bytes = URDF) -> Path:
    """A scene with its robot."""
    put(folder / "arm.urdf", urdf)
    return put(folder / "scene.yaml", text)


def checked(folder: Path, text: str | bytes = SCENE, urdf: str | bytes = URDF) -> Answer:
    return ["check", scene_file(folder, text, urdf), "--json", folder / "out.json"]


def swept(folder: Path, text: str | bytes = SWEEP) -> Answer:
    over = put(folder / "sweep.yaml", text)
    return [
        "sweep",
        scene_file(folder),
        "--over",
        over,
        "--workers",
        1,
        "--out",
        folder / "out.sweep",
    ]


def designed(folder: Path, suffix: str, mesh: bytes) -> Answer:
    return ["grasp", "design", put(folder / f"body{suffix}", mesh), "--out", folder / "scene.yaml"]


def drawn(folder: Path, suffix: str, mesh: bytes) -> Answer:
    """The replay of a run whose object and robot have this mesh, which may be left out."""
    put(folder / f"x{suffix}", mesh)
    scene = SCENE.replace("cylinder: {radius: 0.2, height: 0.05}", f"mesh: {{file: x{suffix}}}")
    scene = scene.replace("mass: 3.0", "mass: 3.0\n  inertia: [0.1, 0.1, 0.1]")
    urdf = URDF.replace('<box size="0.4 0.052 0.028"/>', f'<mesh filename="x{suffix}"/>')
    run = [
        "run",
        scene_file(folder, scene, urdf),
        "--duration",
        0.01,
        "--quiet",
        "--no-certificate",
    ]
    return [*run, "--out", folder / "run.h5", "--replay-html", folder / "replay.html"]


def of_file(folder: Path, suffix: str, content: bytes) -> Answer:
    """The command that reads a file of the corpus."""
    if suffix == ".yaml":
        return checked(folder, content)
    if suffix == ".urdf":
        return checked(folder, SCENE, content)
    return designed(folder, suffix, content)


def everything_of_run(path: Path) -> None:
    run = ma.load_trajectory(path)
    try:
        run.summary(), run.scene, run.events, run.certificate, run.statistics
        for name in run.channels:
            values = run.channel(name)
            assert values.dtype == float and np.isfinite(values).all(), f"{name} is not finite"
            assert len(values) == len(run), f"{name} has other samples"
        assert np.all(np.diff(run.time) >= 0.0), "times go back"
    finally:
        run.close()


def everything_of_sweep(path: Path) -> None:
    sweep = ma.load_sweep(path)
    sweep.table, sweep.summary(), sweep.scene, sweep.count, sweep.complete, sweep.provenance
    sweep.plan.spec.values(1), repr(sweep)


@cache
def stored_run() -> bytes:
    """The file of a short run."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        blocks = [sample_run.samples(0.4)]
        sample_run.record(Hdf5Sink(path), blocks, metadata=provenance(STORED)).close()
        return path.read_bytes()


@cache
def stored_sweep() -> dict[str, bytes]:
    """The files of a small sweep, by their paths in its folder."""
    with tempfile.TemporaryDirectory() as name:
        scene, out = scene_file(Path(name)), Path(name) / "s.sweep"
        path = ma.sweep(scene, yaml.safe_load(SWEEP), out=out, workers=1).path
        files = [file for file in path.rglob("*") if file.is_file()]
        return {
            PART if file.suffix == ".parquet" else file.name: file.read_bytes() for file in files
        }


@cache
def system() -> ma.System:
    with tempfile.TemporaryDirectory() as folder:
        return ma.compile_system(ma.load_scene(scene_file(Path(folder))))


# --- what is demanded of an answer ---------------------------------------------------------------


class TooSlowError(BaseException):
    """The answer takes too long."""


@contextmanager
def limits() -> Iterator[None]:
    """Limits of time and memory."""

    def end(*_: Any) -> None:
        raise TooSlowError

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    handler = signal.signal(signal.SIGALRM, end)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY, hard))
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGALRM, handler)


@contextmanager
def descriptors() -> Iterator[Any]:
    """What libraries write to stdout and stderr below Python, in a file."""
    sys.stdout.flush(), sys.stderr.flush()
    with tempfile.TemporaryFile() as file:
        saved = os.dup(1), os.dup(2)
        os.dup2(file.fileno(), 1), os.dup2(file.fileno(), 2)
        try:
            yield file
        finally:
            for number, copy in zip((1, 2), saved, strict=True):
                os.dup2(copy, number)
                os.close(copy)


def shortcomings(folder: Path, answer: Answer, refused: bool = False) -> list[str]:
    """What is wrong with the answer; with ``refused`` also that there is none."""
    before = os.getcwd()
    os.chdir(folder)
    try:
        with warnings.catch_warnings(), limits(), descriptors() as below:
            warnings.simplefilter("error")
            warnings.simplefilter("always", UserWarning)  # multiarm's own
            if callable(answer):
                faults = _of_call(answer, refused)
            else:
                warnings.simplefilter("default", RuntimeWarning)  # the command line translates them
                faults = _of_command([str(word) for word in answer], refused)
            below.seek(0)
            printed = below.read(2000).decode("utf-8", "replace")
    except TooSlowError:
        return ["slow"]
    finally:
        os.chdir(before)
    if printed:
        faults.append(f"a library prints: {printed[:200]!r}")
    return [*faults, *_not_finite(folder)]


def _of_call(call: Callable[[], Any], refused: bool) -> list[str]:
    try:
        with redirect_stdout(io.StringIO()) as out, redirect_stderr(out):
            result = call()
    except MultiarmError as error:
        return _of_message(str(error))
    except Exception as error:
        return [f"traceback: {_origin(error)}"]
    if getattr(result, "status", "") == "failed":
        return _of_message(result.message)
    return ["accepted"] if refused else []


def _of_command(words: list[str], refused: bool) -> list[str]:
    result = multiarm(*words)
    if isinstance(result.exception, TooSlowError):
        return ["slow"]
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        return [f"traceback: {_origin(result.exception)}"]
    if result.exit_code == 0:
        warned = [line for line in result.stderr.splitlines() if line.startswith("warning: ")]
        faults = [fault for line in warned for fault in _of_message(line)]
        return [*faults, "accepted"] if refused else faults
    if result.exit_code not in (1, 2):
        return [f"exit code {result.exit_code}"]
    faults = _of_message(result.stderr)
    errors = len(re.findall(r"^error: |^╭─ Error", result.stderr, re.MULTILINE))
    return faults if errors == 1 else [*faults, f"{errors} errors: {result.stderr[:300]!r}"]


def _of_message(text: str) -> list[str]:
    if not text.strip():
        return ["empty message"]
    faults = []
    if len(text) > LONGEST:
        faults.append(f"long: {len(text)} characters, {text[:60]!r}")
    if raw := RAW.search(text):
        faults.append(f"raw words: {raw[0]!r} in {text[:200]!r}")
    return faults


def _origin(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "/multiarm/" in frame.filename] or frames
    where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else "?"
    return f"{type(error).__name__} at {where}: {str(error)[:150]!r}"


def _not_finite(folder: Path) -> list[str]:
    """Numbers that are not finite in files that were written."""
    faults = []
    report = folder / "out.json"
    if report.is_file() and re.search(r"\b(NaN|Infinity)\b", report.read_text(encoding="utf-8")):
        faults.append("a number in out.json is not finite")

    def visit(name: str, item: Any) -> None:
        is_numbers = isinstance(item, h5py.Dataset) and item.dtype.kind == "f"
        if is_numbers and not np.isfinite(item[()]).all():
            faults.append(f"{name} is not finite")

    run = folder / "run.h5"
    if run.is_file() and h5py.is_hdf5(run):
        with h5py.File(run) as file:
            file.visititems(visit)
    return faults
