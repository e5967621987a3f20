"""Look for inputs that have no clear answer.

    python tests/support/fuzz.py --minutes 30

Each file of the corpus (``tests/data/corpus``: ``refused`` has to be refused, ``unusual`` may be
valid) is answered as it is.  Then Hypothesis damages these files, robots, scenes, stored runs and
sweeps, and draws options of commands and arguments of functions, until the time is over.  It keeps
what failed in ``.hypothesis`` and begins with that the next time; a crash leaves its input in the
folder that is printed first.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import os
import re
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import yaml
from hostile_inputs import (
    CORPUS,
    PART,
    SCENE,
    SWEEP,
    URDF,
    Answer,
    checked,
    drawn,
    everything_of_run,
    everything_of_sweep,
    of_file,
    put,
    scene_file,
    shortcomings,
    stored_run,
    stored_sweep,
    swept,
    system,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyarrow import parquet
from repository import SCENES

import multiarm as ma

# --- what Hypothesis draws -----------------------------------------------------------------------

TOKENS = (
    *(bytes([byte]) for byte in b"[]{}:-&*!|>@`'\"#,?~9v \0\n\t\x1b\xff"),
    b"\xe2\x80\xa8", b"{a: ", b"&a ", b"*a", b"<<: ", b"!!int ", b"!!python/name:os.system",
    b".nan", b".inf", b"nan", b"1e400", b"0x", b"1:2", b"null", b"2024-01-01", b"<a>", b"</a>",
    b"&a;", b"<!--", b"usemtl ", b"solid ",
)  # fmt: skip
JUNK = st.sampled_from(
    (None, "", "x", "x" * 5000, "\0", "a/b", -1, 0, 1, 1e308, 1e-320, 10**400, math.nan, math.inf,
     True, [], {}, [1, 2, 3], [[]], {"a": 1}, {"": 1}, b"\0\1")
)  # fmt: skip
NUMBERS = st.sampled_from(
    ("nan", "inf", "-inf", "1e400", "1e300", "1e-300", "1e-12", "-1", "0", "1", "x", "", "0x10",
     "9" * 30, "9" * 5000)
)  # fmt: skip
ODD_PATHS = st.sampled_from(
    ("", ".", "/dev/zero", "/dev/full", "/dev/null", "/proc/x", "/proc/self/mem", "none/x",
     "scene.yaml/below", "~nobody_there/x", "a\0b", "a\x1b[31mb", os.fsdecode(b"\xff.yaml"),
     "x" * 5000, "/".join(["x" * 200] * 50), "itself", "pipe", "folder")
)  # fmt: skip
RUN_OPTIONS = (
    "duration", "accuracy", "output-step", "tolerance", "step", "most-steps", "integrator", "arms",
)  # fmt: skip
DESIGN_OPTIONS = (
    "mass", "duration", "tip-radius", "height", "offset", "gripper-size", "scale", "seed", "gap",
)  # fmt: skip
RUN_ARGUMENTS = (
    "duration", "max_step", "output_step", "sample_time", "integrator", "step", "state", "control",
    "out", "progress",
)  # fmt: skip
STATE_ARGUMENTS = (
    "object_position", "object_quaternion_xyzw", "object_twist", "joint_positions",
    "joint_velocities",
)  # fmt: skip
FUNCTIONS = (
    "simulate", "compile_system", "evaluate", "Stepper", "replay", "simulate_many", "load_scene",
    "load_trajectory", "load_sweep",
)  # fmt: skip


@st.composite
def damaged(draw: st.DrawFn, content: bytes) -> bytes:
    """Bytes of which some are lost, overwritten, repeated, or come from elsewhere."""
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(data)))
        end = at + draw(st.sampled_from((0, 1, 4, 64, 1024)))
        piece = draw(st.sampled_from(TOKENS) | st.binary(max_size=8))
        data[at:end] = piece * draw(st.sampled_from((0, 1, 1, 1, 2, 20_000)))
    return bytes(data)


def places(tree: Any, way: tuple = ()) -> Iterator[tuple]:
    parts = (
        tree.items()
        if isinstance(tree, dict)
        else enumerate(tree)
        if isinstance(tree, list)
        else ()
    )
    for key, item in parts:
        yield (*way, key)
        yield from places(item, (*way, key))


@st.composite
def edited(draw: st.DrawFn, tree: Any) -> Any:
    """A table in which something is missing, renamed, doubled, or another value."""
    tree = yaml.safe_load(yaml.safe_dump(tree))
    *way, last = draw(st.sampled_from(list(places(tree))))
    owner = tree
    for part in way:
        owner = owner[part]
    action = draw(st.sampled_from(("value", "value", "delete", "rename", "double")))
    if action == "delete":
        del owner[last]
    elif action == "rename" and isinstance(owner, dict):
        owner[f"{last}x"] = owner.pop(last)
    elif action == "double" and isinstance(owner, list):
        owner.insert(last, owner[last])
    else:
        owner[last] = draw(JUNK)
    return tree


@st.composite
def files(draw: st.DrawFn, folder: Path) -> Answer:
    path = draw(st.sampled_from(sorted(CORPUS.rglob("*.*"))))
    content = draw(damaged(path.read_bytes()))
    if path.suffix == ".yaml" and draw(st.booleans()):
        return swept(folder, content)
    if path.suffix not in (".yaml", ".urdf") and draw(st.booleans()):
        return drawn(folder, path.suffix, content)
    return of_file(folder, path.suffix, content)


@st.composite
def scenes(draw: st.DrawFn, folder: Path) -> Answer:
    names = ("two_ur5_box", "hinged_box", "corner_grippers_block", "three_panda_plate")
    texts = [SCENE, *((SCENES / f"{name}.yaml").read_text(encoding="utf-8") for name in names)]
    scene = draw(edited(yaml.safe_load(draw(st.sampled_from(texts)))))
    return checked(folder, yaml.safe_dump(scene, sort_keys=False, allow_unicode=True))


@st.composite
def sweeps(draw: st.DrawFn, folder: Path) -> Answer:
    return swept(folder, yaml.safe_dump(draw(edited(yaml.safe_load(SWEEP))), sort_keys=False))


@st.composite
def robots(draw: st.DrawFn, folder: Path) -> Answer:
    """Attributes of a URDF with other values."""
    values = list(re.finditer(r'"[^"]*"', URDF))
    at = draw(st.sampled_from(values))
    value = draw(NUMBERS | st.sampled_from(("1 2", "tip", "joint_1", "x" * 5000)))
    return checked(folder, SCENE, f'{URDF[: at.start()]}"{value}"{URDF[at.end() :]}')


@st.composite
def runs(draw: st.DrawFn, folder: Path) -> Answer:
    """A stored run with other bytes, datasets, links or attributes."""
    path = put(folder / "stored.h5", stored_run())
    if draw(st.integers(0, 3)) == 0:
        put(path, draw(damaged(stored_run())))
    else:
        with h5py.File(path, "r+") as file:
            _change_hdf5(draw, file)
    page = folder / "page.html"
    commands = (["replay", path, "--html", page], ["report", path, "--out", page])
    return draw(st.sampled_from((lambda: everything_of_run(path), *commands)))


def _change_hdf5(draw: st.DrawFn, file: h5py.File) -> None:
    names: list[str] = []
    file.visit(names.append)
    name = draw(st.sampled_from(names))
    item = file[name]
    if isinstance(item, h5py.Dataset) and item.dtype.kind in "fi" and draw(st.booleans()):
        numbers = st.sampled_from((-7, 0, 9, 10**9, 2**62))
        if item.dtype.kind == "f":
            numbers |= st.sampled_from((math.nan, math.inf))
        item[draw(st.sampled_from((0, -1, ...)))] = draw(numbers)
        return
    if draw(st.booleans()):
        owner = file[draw(st.sampled_from(("/", name)))]
        keys = [*owner.attrs, "format", "unit", "columns"]
        key = draw(st.sampled_from(keys))
        value = draw(st.sampled_from(
            (None, 7, -1, "x", "x" * 50_000, math.nan, [1.5], [["a", "b"]], ["time", "../time"],
             np.bytes_(b"\xff"), "[" * 50_000)
        ))  # fmt: skip
        if value is not None:
            owner.attrs[key] = value
        elif key in owner.attrs:
            del owner.attrs[key]
        return
    del file[name]
    replacement = draw(st.sampled_from(
        (None, 7, 1.5, "hello", "", "[" * 50_000, ["a", "b"], np.zeros(0), np.zeros((2, 2)),
         np.zeros((41, 6, 2)), np.arange(41), np.zeros(41, complex), np.zeros(41, "V8"),
         np.zeros(41, [("a", float)]), h5py.Empty("f8"), "huge", "group",
         h5py.SoftLink("/nobody"), h5py.SoftLink(f"/{name}"), h5py.SoftLink("/"),
         h5py.ExternalLink("/etc/passwd", "/time"), h5py.ExternalLink("stored.h5", f"/{name}"))
    ))  # fmt: skip
    if replacement is None:
        return
    if isinstance(replacement, str) and replacement == "huge":
        file.create_dataset(name, (2**50,), "f8", chunks=(512,))
    elif isinstance(replacement, str) and replacement == "group":
        file.create_group(name)
    else:
        file[name] = replacement


@st.composite
def stored_sweeps(draw: st.DrawFn, folder: Path) -> Answer:
    """A stored sweep one of whose files is missing or another."""
    contents = dict(stored_sweep())
    name = draw(st.sampled_from(sorted(contents)))
    action = draw(st.sampled_from(("edit", "damage", "delete")))
    if action == "delete":
        del contents[name]
    elif action == "edit" and name == "about.json":
        about = draw(edited(json.loads(contents[name])))
        contents[name] = json.dumps(about, default=repr).encode()
    elif action == "edit" and name == PART:
        table = parquet.read_table(io.BytesIO(contents[name]))
        column = draw(st.sampled_from(table.column_names))
        values = draw(
            st.sampled_from(
                ([-5, 2, 3, 4], [10**12] * 4, ["a"] * 4, [[1.0]] * 4, [None] * 4, [math.nan] * 4)
            )
        )
        table = table.set_column(table.column_names.index(column), column, pa.array(values))
        sink = io.BytesIO()
        parquet.write_table(table if draw(st.booleans()) else table.drop_columns([column]), sink)
        contents[name] = sink.getvalue()
    else:
        contents[name] = draw(damaged(contents[name]))
    for file, content in contents.items():
        put(folder / "s.sweep" / file, content)
    return lambda: everything_of_sweep(folder / "s.sweep")


@st.composite
def commands(draw: st.DrawFn, folder: Path) -> Answer:
    """Options with values, and files at places, that make no sense."""
    scene, out = scene_file(folder), folder / "run.h5"
    over = put(folder / "sweep.yaml", SWEEP)
    stored = put(folder / "stored.h5", stored_run())
    (folder / "itself").symlink_to(folder / "itself")
    (folder / "folder").mkdir(), os.mkfifo(folder / "pipe")
    number, path = draw(NUMBERS), draw(ODD_PATHS)
    sweep = ["sweep", scene, "--over", over, "--workers", 1, "--out", folder / "out.sweep"]
    design = ["grasp", "design", "box:1.2,0.8,0.6", "--out", folder / "s.yaml"]
    return draw(st.sampled_from((
        *(["run", scene, "--out", out, f"--{name}", number] for name in RUN_OPTIONS),
        ["run", scene, "--out", out, "--integrator", "rk4", "--step", number],
        *([*sweep, f"--{name}", number] for name in ("repeat", "seed")),
        ["replay", stored, "--html", folder / "r.html", "--fps", number],
        ["replay", stored, "--html", folder / "r.html", "--speed", number],
        *([*design, f"--{name}", number] for name in DESIGN_OPTIONS),
        *(["grasp", "design", f"{body}:{number},1,1", "--out", folder / "s.yaml"]
          for body in ("box", "prism", "wedge", "sphere")),
        *([*command.split(), path] for command in
          ("check", "pose", "grasp check", "grasp design", "replay", "report")),
        ["run", path, "--out", out], ["run", scene, "--out", path],
        ["run", scene, "--out", out, "--replay-html", path], ["check", scene, "--json", path],
        ["sweep", scene, "--over", path, "--out", folder / "o.sweep"],
        *([word, number] for word in ("joints", "methods", "schema", "stability", "nobody")),
    )))  # fmt: skip


@st.composite
def calls(draw: st.DrawFn, folder: Path) -> Answer:
    """Arguments of functions that are something else."""
    held, start = system(), system().initial_state()
    arrays = st.sampled_from((np.zeros(11), np.zeros((2, 2)), [math.nan, 0.0]))
    value = draw(JUNK | arrays | st.sampled_from((held.scene, held, start)))
    short = {"duration": 0.01}
    answers: list[Callable[[], Any]] = [
        *(lambda name=name: ma.simulate(held, **{**short, name: value}) for name in RUN_ARGUMENTS),
        *(lambda name=name: held.state(**{name: value}) for name in STATE_ARGUMENTS),
        *(lambda name=name: getattr(ma, name)(value) for name in FUNCTIONS),
        lambda: held.state(joint_positions={"left": value}),
        lambda: held.state(joint_positions={"nobody": value}),
        lambda: ma.evaluate(held, value),
        lambda: ma.evaluate(held, 0.0, value),
        lambda: ma.Stepper(held, state=value),
        lambda: ma.Stepper(held).advance(value),
        lambda: ma.simulate(held, control=lambda t, x: value, **short),
        lambda: ma.simulate(held, control=lambda t, x: {"left": value}, **short),
        lambda: ma.inverse_dynamics(held, value, np.zeros(6)),
        lambda: ma.inverse_dynamics(held, start, value),
        lambda: ma.compile_system(held.scene, value),
        lambda: ma.compile_system(held.scene, arms=value),
        lambda: ma.Scene(value),
        lambda: held.with_solver(value),
        lambda: ma.report(value, folder / "x.html"),
        lambda: ma.sweep(value, {"object.mass": [1]}),
    ]
    return draw(st.sampled_from(answers))


KINDS = (files, scenes, sweeps, robots, runs, stored_sweeps, commands, calls)


# --- the nightly run -----------------------------------------------------------------------------


def judge_corpus(folder: Path) -> list[str]:
    failures = []
    for number, path in enumerate(sorted(CORPUS.rglob("*.*"))):
        place = folder / str(number)
        place.mkdir()
        answer = of_file(place, path.suffix, path.read_bytes())
        if faults := shortcomings(place, answer, refused=path.parent.name == "refused"):
            failures.append(f"{path.relative_to(CORPUS)}: {'; '.join(faults)}")
            print(failures[-1], flush=True)
    return failures


def judge_kind(kind: Callable[[Path], st.SearchStrategy], folder: Path, examples: int) -> list[str]:
    """Failures of so many examples, each shrunk by Hypothesis."""
    judged = 0

    @settings(max_examples=examples, deadline=None, suppress_health_check=list(HealthCheck))
    @given(st.data())
    def every_answer_is_clear(data: st.DataObject) -> None:
        nonlocal judged
        judged += 1
        place = Path(tempfile.mkdtemp(dir=folder))
        faults = shortcomings(place, data.draw(kind(place)))
        assert not faults, "; ".join(faults)

    try:
        every_answer_is_clear()
    except Exception as error:
        traceback.print_exception(error)
        return [f"{kind.__name__}: {error}"]
    finally:
        print(f"{kind.__name__}: {judged} answers", flush=True)
    return []


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=30)
    parser.add_argument("--kind", choices=[kind.__name__ for kind in KINDS], help="only this")
    options = parser.parse_args()
    kinds = [kind for kind in KINDS if options.kind in (None, kind.__name__)]
    end = time.monotonic() + 60 * options.minutes
    folder = Path(tempfile.mkdtemp(prefix="hostile-"))
    print(f"inputs in {folder}", flush=True)
    failures = judge_corpus(folder) if options.kind is None else []
    while time.monotonic() < end:
        for kind in kinds:
            with tempfile.TemporaryDirectory(dir=folder) as place:
                failures += judge_kind(kind, Path(place), 40)
    print("\n".join(["failures:", *failures]) if failures else "every answer is clear")
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
