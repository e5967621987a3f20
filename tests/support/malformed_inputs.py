"""Malformed inputs of every format, made by code with fixed seeds: what a program may be given.

A case has a name, the words of a command or a call of the API in a folder, and what is demanded of
the answer.  Nothing here judges answers; judge_inputs.py does.
"""

from __future__ import annotations

import io
import json
import math
import os
import random
import shutil
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import sample_run
import yaml
from pyarrow import parquet
from repository import ROOT, SCENES

import multiarm as ma
from multiarm.results.sinks import Hdf5Sink, provenance

URDF = (ROOT / "robots" / "planar_2r" / "planar_2r.urdf").read_text(encoding="utf-8")


@dataclass(frozen=True)
class Case:
    """One input.

    Attributes
    ----------
    kind, name : str
        The sort of input, and what is wrong with it.
    make : callable
        ``make(folder)`` writes files, and gives the words of a command or a function to be called.
    refused : bool
        Accepting it is a failure; else it may be valid all the same.
    heavy : bool
        It can exhaust memory or time: for a process of its own.
    """

    kind: str
    name: str
    make: Callable[[Path], list[Any] | Callable[[], Any]]
    refused: bool = True
    heavy: bool = False

    def __str__(self) -> str:
        return f"{self.kind}: {self.name}"


# --- scenes and sweeps that are valid ------------------------------------------------------------

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


def scene_file(folder: Path, text: str | bytes = SCENE, urdf: str | bytes = URDF) -> Path:
    """A scene with its robot."""
    put(folder / "arm.urdf", urdf)
    return put(folder / "scene.yaml", text)


def put(path: Path, content: str | bytes) -> Path:
    if isinstance(content, str):
        content = content.encode("utf-8", "surrogatepass")
    path.write_bytes(content)
    return path


def named(text: str) -> str:
    """A text in the name of a case; of a long one its beginning and its length."""
    return text if len(text) <= 40 else f"{text[:20]}... ({len(text)} characters)"


def checked(text: str | bytes) -> Callable[[Path], list[Any]]:
    """``multiarm check`` of a scene."""
    return lambda folder: [
        "check", scene_file(folder, text), "--json", folder / "out.json"
    ]  # fmt: skip


def with_robot(urdf: str | bytes) -> Callable[[Path], list[Any]]:
    """``multiarm check`` of a scene with this robot."""
    return lambda folder: [
        "check", scene_file(folder, SCENE, urdf), "--json", folder / "out.json"
    ]  # fmt: skip


def swept(text: str | bytes) -> Callable[[Path], list[Any]]:
    """``multiarm sweep`` of the scene."""

    def make(folder: Path) -> list[Any]:
        over = put(folder / "sweep.yaml", text)
        out = folder / "out.h5"
        return ["sweep", scene_file(folder), "--over", over, "--workers", 1, "--out", out]

    return make


# --- YAML ----------------------------------------------------------------------------------------

LAUGHS = "a0: &a0 [lol, lol]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12)
)
TEXTS: dict[str, str | bytes] = {
    "empty": "", "white": " \n\n", "comment": "# nothing\n", "null": "null", "text": "hello",
    "number": "17", "list": "[1, 2]", "a list of tables": "- {a: 1}\n- {b: 2}\n",
    "two documents": "{}\n---\n{}\n", "NUL": "name: \0\n", "NUL first": b"\0\0\0\0",
    "byte order mark alone": b"\xef\xbb\xbf", "UTF-16": "name: x\n".encode("utf-16"),
    "latin-1": "name: \u00fc\n".encode("latin-1"), "invalid UTF-8": b"name: \xff\xfe\n",
    "tab": "object:\n\tmass: 1\n", "key twice": "name: a\nname: b\n", "key null": "null: 1\n",
    "key number": "1: 1\n", "key true": "true: 1\n", "key list": "[a]: 1\n", "key table": "{a: 1}: 1\n",
    "key list of a list": "? [[a]]\n: 1\n", "key long": f"{'k' * 100_000}: 1\n",
    "key huge number": f"{'9' * 5000}: 1\n", "key date": "2024-01-01: 1\n",
    "key set": "? !!set {a}\n: 1\n", "key nan": ".nan: 1\n",
    "deep list": "a: " + "[" * 20_000 + "]" * 20_000, "deep unclosed": "[" * 100_000,
    "deep table": "a: " + "{a: " * 3000 + "1" + "}" * 3000,
    "deep blocks": "".join(f"{' ' * k}a:\n" for k in range(1500)),
    "deep key": "? " + "[" * 5000 + "]" * 5000 + "\n: 1", "deep dashes": "- " * 20_000 + "1",
    "laughs": LAUGHS, "laughs as keys": LAUGHS + "? *a11\n: 1\n", "recursive list": "a: &a [*a]\n",
    "recursive table": "&a {name: *a}\n", "recursive root": "&a [*a]", "recursive key": "&a {*a : 1}\n",
    "unknown alias": "name: *nobody\n", "merge of a number": "<<: 1\n", "merge of itself": "&a\n<<: *a\n",
    "merge of a list": "<<: [1, 2]\n", "python object": "name: !!python/object:os.system {}\n",
    "python apply": "!!python/object/apply:os.system [ls]", "python name": "name: !!python/name:os.system\n",
    "own tag": "name: !mine 1\n", "tag of nobody": "name: !<tag:x,2000:y> 1\n", "bad tag": "name: !<\n",
    "tag int": "name: !!int abc\n", "tag int empty": "name: !!int ''\n", "tag int minus": "name: !!int '-'\n",
    "tag int float": "name: !!int 1.5\n", "tag float": "name: !!float abc\n",
    "tag float empty": "name: !!float ''\n", "tag bool": "name: !!bool perhaps\n",
    "tag null": "name: !!null 7\n", "tag timestamp": "name: !!timestamp today\n",
    "tag timestamp month": "name: !!timestamp 2024-13-01\n", "tag binary": "name: !!binary '*'\n",
    "tag binary non-ascii": "name: !!binary \u00fc\n", "tag set": "!!set {a, b}", "tag omap": "!!omap [a: 1]",
    "tag omap bad": "!!omap [1, 2]", "tag pairs": "!!pairs [a: 1]", "tag pairs bad": "!!pairs 1",
    "tag map of text": "name: !!map x\n", "tag seq of text": "name: !!seq x\n", "tag str of list": "name: !!str [a]\n",
    "tag set of list": "name: !!set [a]\n", "tag set of text": "name: !!set a\n",
    "month 13": "name: 2024-13-40\n", "date": "2024-01-01", "hour 99": "name: 2024-01-01 99:00:00\n",
    "sexagesimal": "gravity: 1:2:99999999999999999999\n", "huge integer": f"gravity: {'1' * 5000}\n",
    "huge hexadecimal": f"gravity: 0x{'f' * 5000}\n", "huge octal": f"gravity: 0{'7' * 6000}\n",
    "huge binary": f"gravity: 0b{'1' * 20_000}\n", "huge exponent": f"gravity: 1e{'9' * 500}\n",
    "underscores": "gravity: 0x_\n", "binary without digits": "gravity: 0b_\n", "octal without": "gravity: 0_\n",
    "colons": f"gravity: {':'.join(['59'] * 2000)}\n", "unclosed text": "name: 'x\n", "unclosed list": "a: [1\n",
    "stray brace": "a: }\n", "stray percent": "%YAML 9.9\n---\na: 1\n", "bad directive": "%TAG ! \n---\n1",
    "bad escape": 'name: "\\q"\n', "bad unicode escape": 'name: "\\UFFFFFFFF"\n',
    "surrogate escape": 'name: "\\ud800"\n', "control characters": "name: \x1b[31m\n",
    "megabyte of text": "x: " + "y" * 1_000_000 + "\n", "megabyte of a name": "object: " + "y" * 1_000_000 + "\n",
    "million numbers": "gravity: [" + "1, " * 200_000 + "1]\n", "ten thousand keys": "".join(f"k{k}: 1\n" for k in range(10_000)),
}  # fmt: skip
PLACED: dict[str, tuple[str, str]] = {
    # what is replaced in the valid scene, and by what
    "mass date": ("mass: 3.0", "mass: 2024-01-01"), "mass text": ("mass: 3.0", "mass: heavy"),
    "mass nan": ("mass: 3.0", "mass: .nan"), "mass inf": ("mass: 3.0", "mass: .inf"),
    "mass 1e400": ("mass: 3.0", "mass: 1e400"), "mass negative": ("mass: 3.0", "mass: -1"),
    "mass zero": ("mass: 3.0", "mass: 0"), "mass huge integer": ("mass: 3.0", "mass: " + "9" * 5000),
    "mass integer of 400": ("mass: 3.0", "mass: " + "9" * 400), "mass true": ("mass: 3.0", "mass: true"),
    "mass binary": ("mass: 3.0", "mass: !!binary aGVsbG8="), "mass set": ("mass: 3.0", "mass: !!set {a}"),
    "mass list": ("mass: 3.0", "mass: [1]"), "mass sexagesimal": ("mass: 3.0", "mass: 1:30"),
    "mass 1e308": ("mass: 3.0", "mass: 1e308"), "mass 1e-320": ("mass: 3.0", "mass: 1e-320"),
    "radius 1e200": ("radius: 0.2", "radius: 1e200"), "radius 1e-200": ("radius: 0.2", "radius: 1e-200"),
    "gravity 1e308": ("gravity: [0.5, -9.81, 0.0]", "gravity: [1e308, 1e308, 1e308]"),
    "gravity of two": ("gravity: [0.5, -9.81, 0.0]", "gravity: [1, 2]"),
    "gravity recursive": ("gravity: [0.5, -9.81, 0.0]", "gravity: &g [*g, *g, *g]"),
    "name number": ("name: two arms hold a disc", "name: 5"), "name null": ("name: two arms hold a disc", "name:"),
    "name megabyte list": ("name: two arms hold a disc", "name: [" + "1, " * 100_000 + "1]"),
    "key megabyte": ("mass: 3.0", f"{'m' * 1_000_000}: 3.0"), "key number": ("mass: 3.0", "1: 3.0\n  mass: 3.0"),
    "key null": ("mass: 3.0", "null: 3.0\n  mass: 3.0"), "key true": ("mass: 3.0", "true: 3.0\n  mass: 3.0"),
    "arm number": ("left: {", "1: {"), "arm null": ("left: {", "null: {"), "arm text": ("left: {", "'a/b': {"),
    "arm megabyte": ("left: {", f"{'l' * 500_000}: {{"), "arms list": ("arms:", "arms: [1]\nfurther:"),
    "joint kind number": ("kind: ball", "kind: 1"), "joint kind list": ("kind: ball", "kind: [ball]"),
    "joint kind megabyte": ("kind: ball", f"kind: {'b' * 500_000}"), "joint kind null": ("kind: ball", "kind:"),
    "joint arm table": ("arm: left", "arm: {a: 1}"), "joint arm huge": ("arm: left", "arm: " + "7" * 5000),
    "tip path": ("tip: tip", "tip: [tip]"), "tip megabyte": ("tip: tip", f"tip: {'t' * 500_000}"),
    "urdf folder": ("urdf: arm.urdf", "urdf: ."), "urdf null byte": ("urdf: arm.urdf", 'urdf: "a\\0b"'),
    "urdf long": ("urdf: arm.urdf", f"urdf: {'a' * 5000}"), "urdf megabyte": ("urdf: arm.urdf", f"urdf: {'a' * 500_000}"),
    "urdf surrogate": ("urdf: arm.urdf", 'urdf: "\\udcff"'), "urdf device": ("urdf: arm.urdf", "urdf: /dev/zero"),
    "urdf number": ("urdf: arm.urdf", "urdf: 5"), "urdf of nobody's home": ("urdf: arm.urdf", "urdf: ~nobody_there/x"),
    "urdf missing": ("urdf: arm.urdf", "urdf: none.urdf"), "robot unknown": ("urdf: arm.urdf", "robot: " + "u" * 100_000),
    "posture nan": ("posture: [0.7, -1.2]", "posture: [.nan, 1]"), "posture long": ("posture: [0.7, -1.2]", "posture: [" + "1, " * 100_000 + "1]"),
    "posture 1e300": ("posture: [0.7, -1.2]", "posture: [1e300, 1]"), "posture joint": ("posture: [0.7, -1.2]", "posture: {" + "q" * 100_000 + ": 1}"),
    "posture key number": ("posture: [0.7, -1.2]", "posture: {1: 1}"), "base far": ("xyz: [-0.8, 0, 0]", "xyz: [1e300, 0, 0]"),
    "effect unknown": ("joint_damping: 0.5", "joint_dumping: 0.5"), "effect nan": ("joint_damping: 0.5", "joint_damping: .nan"),
    "effect number key": ("joint_damping: 0.5", "1: 0.5"), "effect list": ("effects: {joint_damping: 0.5}", "effects: [1]"),
    "effect huge": ("joint_damping: 0.5", "joint_damping: " + "9" * 5000), "effects text": ("effects: {joint_damping: 0.5}", "effects: x"),
    "duration 1e300": ("duration: 0.02", "duration: 1e300"), "duration nan": ("duration: 0.02", "duration: .nan"),
    "duration inf": ("duration: 0.02", "duration: .inf"), "output_step 1e-300": ("output_step: 0.01", "output_step: 1e-300"),
    "output_step 1e-12": ("output_step: 0.01", "output_step: 1e-12"), "accuracy text": ("accuracy: 0.001", "accuracy: x"),
    "accuracy recursive": ("accuracy: 0.001", "accuracy: &x {position: *x}"),
    "step 1e-300": ("accuracy: 0.001", "integrator: rk4, step: 1e-300"), "step 1e-15": ("accuracy: 0.001", "integrator: rk4, step: 1e-15"),
    "most_steps 1e300": ("accuracy: 0.001", "most_steps: 1e300"), "integrator list": ("accuracy: 0.001", "integrator: [rk4]"),
    "run text": ("run: {duration: 0.02, accuracy: 0.001, output_step: 0.01}", "run: x"),
    "object null": ("  mass: 3.0", "  mass:"), "shape two": ("shape: {cylinder:", "shape: {sphere: 1, cylinder:"),
    "hull million": ("cylinder: {radius: 0.2, height: 0.05}", "hull: [[1, 2, 3]]"),
    "hull flat": ("cylinder: {radius: 0.2, height: 0.05}", "hull: [[0,0,0],[1,0,0],[0,1,0],[1,1,0]]"),
    "hull nan": ("cylinder: {radius: 0.2, height: 0.05}", "hull: [[.nan,0,0],[1,0,0],[0,1,0],[1,1,1]]"),
    "hull huge": ("cylinder: {radius: 0.2, height: 0.05}", "hull: [[1e300,0,0],[-1e300,0,0],[0,1e300,0],[0,0,1e300]]"),
    "inertia huge": ("mass: 3.0", "mass: 3.0\n  inertia: [1e308, 1e308, 1e308]"),
    "inertia tiny": ("mass: 3.0", "mass: 3.0\n  inertia: [1e-320, 1e-320, 1e-320]"),
    "inertia zero": ("mass: 3.0", "mass: 3.0\n  inertia: [0, 0, 0]"),
    "quaternion zero": ("mass: 3.0", "mass: 3.0\n  pose: {quaternion_xyzw: [0, 0, 0, 0]}"),
    "quaternion huge": ("mass: 3.0", "mass: 3.0\n  pose: {quaternion_xyzw: [1e300, 0, 0, 1e300]}"),
    "color nan": ("mass: 3.0", "mass: 3.0\n  color: [.nan, 0, 0]"), "twist 1e300": ("mass: 3.0", "mass: 3.0\n  twist: [1e300, 0, 0, 0, 0, 0]"),
    "function long": ("effects: {joint_damping: 0.5}", "control: {kind: python, function: '" + "f" * 100_000 + ":g'}"),
    "control number": ("effects: {joint_damping: 0.5}", "control: 7"), "control kind number": ("effects: {joint_damping: 0.5}", "control: {kind: 7}"),
}  # fmt: skip
VALID = {  # of the above, those that are unusual and all the same valid, or may be
    "mass 1e308", "mass 1e-320", "radius 1e200", "radius 1e-200", "gravity 1e308", "mass sexagesimal",
    "inertia huge", "inertia tiny", "quaternion huge", "twist 1e300", "most_steps 1e300", "posture 1e300",
    "base far", "tag null", "key null",
}  # fmt: skip


def yaml_cases() -> Iterator[Case]:
    for name, text in TEXTS.items():
        yield Case("scene text", name, checked(text))
    for name, (old, new) in PLACED.items():
        assert old in SCENE, name
        yield Case("scene value", name, checked(SCENE.replace(old, new)), name not in VALID)
    for name, text in TEXTS.items():
        yield Case("sweep text", name, swept(text))


# --- scenes and sweeps that were changed at random -----------------------------------------------

NEVER: tuple[Any, ...] = (math.nan, math.inf, b"\0\1", {1, 2}, 10**400, [[]], {"": 1}, "\0")
"""Nothing that may stand anywhere in a scene."""
JUNK: tuple[Any, ...] = (None, "", "x" * 5000, -1, 0, 1e308, 1e-320, True, [], {}, [1, 2, 3], {"a": 1})


def places(value: Any, way: tuple = ()) -> Iterator[tuple]:
    yield way
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()  # fmt: skip
    for key, item in parts:
        yield from places(item, (*way, key))


def changed(data: Any, rng: random.Random) -> tuple[str, Any, bool]:
    """What was done, the changed data, and whether it cannot be valid any more."""
    data = yaml.safe_load(yaml.safe_dump(data))
    *way, last = rng.choice([place for place in places(data) if place])
    owner = data
    for part in way:
        owner = owner[part]
    where = ".".join(map(str, (*way, last)))
    sort = rng.choice(("delete", "never", "never", "junk", "junk", "rename", "double"))
    if sort == "delete":
        del owner[last]
        return f"{where} deleted", data, False
    if sort == "rename" and isinstance(owner, dict):
        owner[f"{last}x"] = owner.pop(last)
        return f"{where} renamed", data, True
    if sort == "double" and isinstance(owner, list):
        owner.insert(last, owner[last])
        return f"{where} doubled", data, False
    value = rng.choice(NEVER if sort == "never" else JUNK)
    owner[last] = value
    return f"{where} = {named(repr(value))}", data, sort == "never"


def broken(text: str, rng: random.Random) -> tuple[str, str]:
    """A text with characters lost, added or moved."""
    at = rng.randrange(len(text))
    sort = rng.choice(("cut", "lose", "add", "line twice"))
    if sort == "cut":
        return f"cut at {at}", text[:at]
    if sort == "lose":
        end = at + rng.choice((1, 2, 10))
        return f"without {at} to {end}", text[:at] + text[end:]
    if sort == "add":
        extra = rng.choice(list(":{}[]&*!|>%@`'\"#,-?\t\0\n~") + ["\x1b", "\ufeff", "\u2028"])
        return f"{extra!r} at {at}", text[:at] + extra + text[at:]
    lines = text.splitlines(keepends=True)
    line = rng.randrange(len(lines))
    return f"line {line + 1} twice", "".join([*lines[:line], lines[line], *lines[line:]])


BASES = ("two_ur5_box", "hinged_box", "corner_grippers_block", "three_panda_plate")


@cache
def example(name: str) -> str:
    return (SCENES / f"{name}.yaml").read_text(encoding="utf-8")


def random_scene_cases(count: int, seed: int = 1) -> Iterator[Case]:
    for k in range(count):
        rng = random.Random(1000 * seed + k)
        base = BASES[k % len(BASES)] if k % 3 else None
        text = SCENE if base is None else example(base)
        if k % 4 == 3:
            what, new = broken(text, rng)
            wrong = False
        else:
            what, data, wrong = changed(yaml.safe_load(text), rng)
            new = yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
        yield Case("scene at random", f"{k} {base or 'disc'}: {what}", checked(new), wrong)


def random_sweep_cases(count: int, seed: int = 2) -> Iterator[Case]:
    for k in range(count):
        rng = random.Random(1000 * seed + k)
        if k % 4 == 3:
            what, new = broken(SWEEP, rng)
            wrong = False
        else:
            what, data, wrong = changed(yaml.safe_load(SWEEP), rng)
            new = yaml.safe_dump(data, sort_keys=False)
        # a value of a run that makes no valid scene is a row that says so
        wrong = wrong and "values" not in what
        yield Case("sweep at random", f"{k}: {what}", swept(new), wrong)


# --- robots --------------------------------------------------------------------------------------

BOMB = (
    '<?xml version="1.0"?><!DOCTYPE r [<!ENTITY a "aaaaaaaaaa">'
    + "".join(f'<!ENTITY {chr(98 + k)} "{f"&{chr(97 + k)};" * 10}">' for k in range(9))
    + "]><robot name='&j;'/>"
)


def chain(count: int) -> str:
    links = "".join(f"<link name='l{k}'/>" for k in range(count + 1))
    joints = "".join(
        f"<joint name='j{k}' type='revolute'><parent link='l{k}'/><child link='l{k + 1}'/>"
        "<limit lower='-1' upper='1' effort='1' velocity='1'/></joint>"
        for k in range(count)
    )
    return f"<robot name='r'>{links}{joints}</robot>"


AXIS, LIMIT = '<axis xyz="0 0 1"/>', '<limit lower="-6.283185307179586" upper="6.283185307179586" effort="200" velocity="20"/>'
ROBOTS: dict[str, str | bytes] = {
    "empty": "", "text": "hello", "NUL": b"\0" * 100, "no robot": "<a/>", "robot alone": "<robot/>",
    "sdf": "<sdf><model/></sdf>", "cut": URDF[: len(URDF) // 2], "latin-1": URDF.replace("graphite", "gr\u00e4u").encode("latin-1"),
    "UTF-16": URDF.encode("utf-16"), "entities": BOMB, "external entity": "<!DOCTYPE r [<!ENTITY a SYSTEM 'file:///etc/passwd'>]><robot name='&a;'/>",
    "10,000 joints": chain(10_000), "deep XML": "<robot>" + "<a>" * 100_000 + "</a>" * 100_000 + "</robot>",
    "unknown encoding": "<?xml version='1.0' encoding='x-nobody'?><robot name='r'/>",
    "multi-byte encoding": "<?xml version='1.0' encoding='utf-32'?><robot name='r'/>",
    "key megabyte": f"<robot name='r'><link name='{'l' * 1_000_000}'/></robot>", "root megabyte": f"<{'r' * 1_000_000}/>",
    "cycle": URDF.replace('<parent link="base"/>', '<parent link="link_2"/>'),
    "several roots": URDF.replace('<link name="tip"/>', '<link name="tip"/><link name="alone"/>'),
    "a link twice": URDF.replace('<link name="tip"/>', '<link name="tip"/><link name="tip"/>'),
    "a joint twice": URDF.replace('name="joint_2"', 'name="joint_1"'), "unknown child": URDF.replace('child link="tip"', 'child link="tap"'),
    "no links name": URDF.replace('<link name="tip"/>', "<link/>"), "unknown type": URDF.replace('type="fixed"', 'type="loose"'),
    "type megabyte": URDF.replace('type="fixed"', f'type="{"t" * 500_000}"'), "planar": URDF.replace('type="revolute"', 'type="planar"', 1),
    "axis zero": URDF.replace(AXIS, '<axis xyz="0 0 0"/>'), "axis nan": URDF.replace(AXIS, '<axis xyz="nan 0 1"/>'),
    "axis of two": URDF.replace(AXIS, '<axis xyz="0 1"/>'), "axis text": URDF.replace(AXIS, '<axis xyz="a b c"/>'),
    "axis inf": URDF.replace(AXIS, '<axis xyz="inf 0 1"/>'), "axis without": URDF.replace(AXIS, "<axis/>"),
    "axis 1e-300": URDF.replace(AXIS, '<axis xyz="0 0 1e-300"/>'), "axis megabyte": URDF.replace(AXIS, f'<axis xyz="{"1 " * 500_000}"/>'),
    "no limit": URDF.replace(LIMIT, ""), "limit nan": URDF.replace('lower="-6.283185307179586"', 'lower="nan"'),
    "limit inf": URDF.replace('upper="6.283185307179586"', 'upper="inf"'), "limits swapped": URDF.replace('lower="-6.283185307179586"', 'lower="9"'),
    "limit text": URDF.replace('effort="200"', 'effort="much"'), "effort nan": URDF.replace('effort="200"', 'effort="nan"'),
    "effort negative": URDF.replace('effort="200"', 'effort="-1"'), "velocity nan": URDF.replace('velocity="20"', 'velocity="nan"'),
    "velocity megabyte": URDF.replace('velocity="20"', f'velocity="{"v" * 500_000}"'), "mass nan": URDF.replace('mass value="3"', 'mass value="nan"'),
    "mass negative": URDF.replace('mass value="3"', 'mass value="-3"'), "mass text": URDF.replace('mass value="3"', 'mass value="heavy"'),
    "mass inf": URDF.replace('mass value="3"', 'mass value="inf"'), "mass without": URDF.replace('<mass value="3"/>', "<mass/>"),
    "mass 1e308": URDF.replace('mass value="3"', 'mass value="1e308"'), "no mass": URDF.replace('<mass value="3"/>', ""),
    "mass integer": URDF.replace('mass value="3"', f'mass value="{"9" * 500}"'),
    "inertia nan": URDF.replace('ixx="0.0013"', 'ixx="nan"'), "inertia negative": URDF.replace('izz="0.0634"', 'izz="-1"'),
    "inertia text": URDF.replace('ixx="0.0013"', 'ixx="x"'), "inertia incomplete": URDF.replace('ixx="0.0013"', ""),
    "inertia of no body": URDF.replace('izz="0.0634"', 'izz="5"'), "origin nan": URDF.replace('xyz="0.5 0 0"', 'xyz="nan 0 0"'),
    "origin text": URDF.replace('xyz="0.5 0 0"', 'xyz="a 0 0"'), "origin of two": URDF.replace('xyz="0.5 0 0"', 'xyz="0 0"'),
    "origin inf": URDF.replace('xyz="0.5 0 0"', 'xyz="inf 0 0"'), "rpy nan": URDF.replace('rpy="0 0 0"', 'rpy="0 nan 0"'),
    "origin 1e300": URDF.replace('xyz="0.5 0 0"', 'xyz="1e300 0 0"'), "damping nan": URDF.replace(AXIS, AXIS + '<dynamics damping="nan"/>'),
    "damping negative": URDF.replace(AXIS, AXIS + '<dynamics damping="-1"/>'), "mimic itself": URDF.replace(AXIS, AXIS + '<mimic joint="joint_1"/>'),
    "mimic nobody": URDF.replace(AXIS, AXIS + '<mimic joint="nobody"/>', 1), "mimic nan": URDF.replace(AXIS, AXIS + '<mimic joint="joint_2" multiplier="nan"/>', 1),
    "two inertials": URDF.replace("<inertial>", "<inertial/><inertial>", 1), "two parents": URDF.replace('<parent link="base"/>', '<parent link="base"/><parent link="tip"/>'),
    "a link and a joint of one name": URDF.replace('"joint_1"', '"link_1"'), "comma for point": URDF.replace('mass value="3"', 'mass value="3,0"'),
    "hexadecimal": URDF.replace('mass value="3"', 'mass value="0x3"'), "underscore": URDF.replace('upper="6.283185307179586"', 'upper="1_0"'),
    "empty effort": URDF.replace('effort="200"', 'effort=""'), "box nan": URDF.replace('size="0.5 0.06 0.034"', 'size="nan 0 0"'),
    "box negative": URDF.replace('size="0.5 0.06 0.034"', 'size="-1 1 1"'), "cylinder nan": URDF.replace('radius="0.03"', 'radius="nan"'),
    "sphere text": URDF.replace('sphere radius="0.02"', 'sphere radius="x"'), "color text": URDF.replace('rgba="0.10 0.55 0.56 1"', 'rgba="x"'),
    "geometry empty": URDF.replace('<sphere radius="0.02"/>', ""), "material unknown": URDF.replace('<material name="amber"/>', '<material name="nobody"/>'),
}  # fmt: skip
ROBOTS_VALID = {  # a motion needs no shapes; other programs write such files
    "material unknown", "axis without", "effort negative", "mass 1e308", "origin 1e300",
    "damping negative", "axis 1e-300", "two parents", "latin-1", "inertia of no body", "box negative",
}  # fmt: skip


def robot_cases(count: int, seed: int = 3) -> Iterator[Case]:
    for name, text in ROBOTS.items():
        yield Case("robot", name, with_robot(text), name not in ROBOTS_VALID)
    for k in range(count):
        rng = random.Random(1000 * seed + k)
        what, text = broken(URDF, rng)
        yield Case("robot at random", f"{k}: {what}", with_robot(text), False)


# --- runs and sweeps that are stored -------------------------------------------------------------


@cache
def stored_run() -> bytes:
    """The file of a short run."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        blocks = [sample_run.samples(0.4)]
        record = sample_run.record(Hdf5Sink(path), blocks, metadata=provenance(_stored_scene()))
        record.close()
        return path.read_bytes()


@cache
def _stored_scene() -> str:
    arms = {"left": "textbook_6r", "right": "planar_3r"}
    data = {
        "name": "a stored scene", "object": {"shape": {"box": [1, 1, 1]}, "mass": 2.0},
        "arms": {"left": {"robot": arms["left"], "tip": "tool"}, "right": {"robot": arms["right"], "tip": "tip"}},
        "joints": [{"arm": "left", "kind": "weld"}, {"arm": "right", "kind": "ball"}],
    }  # fmt: skip
    return yaml.safe_dump(data)


@cache
def stored_sweep() -> dict[str, bytes]:
    """The files of a small sweep, by their paths in its folder."""
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene_file(folder)
        path = ma.sweep(
            folder / "scene.yaml", yaml.safe_load(SWEEP), out=folder / "s.sweep", workers=1
        ).path
        files = (file for file in path.rglob("*") if file.is_file())
        return {
            "parts/0.parquet" if file.suffix == ".parquet" else file.name: file.read_bytes()
            for file in files
        }


def _used(path: Path) -> Callable[[], Any]:
    """Everything that a stored run tells."""

    def use() -> None:
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

    return use


def _swept(path: Path) -> Callable[[], Any]:
    """Everything that a stored sweep tells."""

    def use() -> None:
        sweep = ma.load_sweep(path)
        sweep.table, sweep.summary(), sweep.scene, sweep.count, sweep.complete, sweep.provenance
        sweep.plan.values(1), repr(sweep)

    return use


def damaged(
    change: Callable[[h5py.File], Any], data: Callable[[], bytes], use: Callable[[Path], Any]
) -> Callable[[Path], Any]:
    """A stored file in which something was changed through HDF5."""

    def make(folder: Path) -> Any:
        path = put(folder / "stored.h5", data())
        with h5py.File(path, "r+") as file:
            change(file)
        return use(path)

    return make


def bytes_changed(rng: random.Random, data: Callable[[], bytes], use: Callable[[Path], Any]):
    """A stored file that was cut, or in which some bytes were overwritten."""

    def make(folder: Path) -> Any:
        content = bytearray(data())
        if rng.random() < 0.4:
            del content[rng.randrange(len(content)) :]
        else:
            at, size = rng.randrange(len(content)), rng.choice((1, 4, 64, 1024))
            if rng.random() < 0.5:
                at %= 4096
            content[at : at + size] = rng.randbytes(size)
        return use(put(folder / "stored.h5", bytes(content)))

    return make


def replaced(name: str, value: Any, **options: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file.create_dataset(name, data=value, **options)

    return change


def without(name: str) -> Callable[[h5py.File], None]:
    return lambda file: file.__delitem__(name)


def attribute(name: str, value: Any, of: str = "/") -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        if value is None:
            del file[of].attrs[name]
        else:
            file[of].attrs[name] = value

    return change


def filled(name: str, at: Any, value: float) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file[name][at] = value

    return change


def linked(name: str, link: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = link

    return change


def edited(name: str, edit: Callable[[Any], Any], attrs: bool = False) -> Callable[[h5py.File], None]:
    """JSON in an attribute of the file or in a text, edited."""

    def change(file: h5py.File) -> None:
        text = file.attrs[name] if attrs else file[name].asstr()[()]
        new = edit(json.loads(text))
        new = new if isinstance(new, str) else json.dumps(new)
        if attrs:
            file.attrs[name] = new
        else:
            replaced(name, new)(file)

    return change


def outcome(edit: Callable[[Any], Any]) -> Callable[[h5py.File], None]:
    """The outcome of a run, edited."""

    def change(file: h5py.File) -> None:
        pieces = int(file["progress"][1])
        data = edit(json.loads(b"".join(file["outcome"][:pieces])))
        text = (data if isinstance(data, str) else json.dumps(data)).encode("utf-8")
        parts = [text[k : k + 120] for k in range(0, len(text), 120)]
        del file["outcome"]
        file.create_dataset("outcome", data=np.array(parts, "S120"), maxshape=(None,), chunks=(64,))
        file["progress"][1] = len(parts)

    return change


T = "object/twist"
RUNS: dict[str, Callable[[h5py.File], Any]] = {
    **{f"without {name}": without(name) for name in ("time", T, "progress", "outcome", "scene", "arms", "arms/left/joint_position", "energy/work", "drift", "solver/rank", "amendment")},
    **{f"attribute {name} {named(repr(value))}": attribute(name, value) for name in ("format", "format_version", "provenance", "channels") for value in (None, 7, "x", [1.5], "x" * 50_000, np.nan)},
    "version 99": attribute("format_version", 99), "version -1": attribute("format_version", -1), "version text": attribute("format_version", "one"),
    "version list": attribute("format_version", [1, 2]), "format bytes": attribute("format", np.bytes_(b"\xff")),
    "channels twice": lambda f: f.attrs.__setitem__("channels", [*f.attrs["channels"], "time"]),
    "channels unknown": lambda f: f.attrs.__setitem__("channels", [*f.attrs["channels"], "nobody"]),
    "channels group": lambda f: f.attrs.__setitem__("channels", [*f.attrs["channels"], "arms"]),
    "channels dots": lambda f: f.attrs.__setitem__("channels", [*f.attrs["channels"], "../time"]),
    "channels without time": lambda f: f.attrs.__setitem__("channels", [n for n in f.attrs["channels"] if n != "time"]),
    "channels without position": lambda f: f.attrs.__setitem__("channels", [n for n in f.attrs["channels"] if n != "object/position"]),
    "channels empty": attribute("channels", np.zeros(0, "S1")), "channels nested": attribute("channels", [["a", "b"], ["c", "d"]]),
    "unit missing": attribute("unit", None, T), "unit number": attribute("unit", 5, T), "description bytes": attribute("description", np.bytes_(b"\xff\xfe"), T),
    "frame list": attribute("frame", [1, 2], T), "columns number": attribute("columns", 5, T), "columns few": attribute("columns", ["a"], T),
    "columns megabyte": attribute("columns", ["a" * 9000] * 6, T),
    "time nan": filled("time", 5, math.nan), "time inf": filled("time", -1, math.inf), "time back": filled("time", 5, -1.0),
    "time all nan": filled("time", slice(None), math.nan), "position nan": filled("object/position", (3, 1), math.nan),
    "torque inf": filled("arms/left/joint_torque", (0, 0), math.inf), "work nan": filled("energy/work", 7, math.nan),
    "progress large": filled("progress", 0, 10**9), "progress huge": filled("progress", 0, 2**62), "progress negative": filled("progress", 0, -5),
    "pieces negative": filled("progress", 1, -1), "pieces large": filled("progress", 1, 10**6), "pieces few": filled("progress", 1, 1),
    "amended negative": filled("amended", 0, -7), "amended large": filled("amended", 1, 10**12), "amended swapped": filled("amended", 0, 9),
    "progress float": replaced("progress", [1.5, 2.5]), "progress nan": replaced("progress", [math.nan, 1.0]), "progress text": replaced("progress", ["a", "b"]),
    "progress scalar": replaced("progress", 5), "progress of one": replaced("progress", [5]), "progress of three": replaced("progress", [41, 3, 3]),
    "progress empty": replaced("progress", np.zeros(0)), "progress matrix": replaced("progress", np.zeros((2, 2))), "amended text": replaced("amended", ["a", "b"]),
    "time text": replaced("time", ["a"] * 41), "time integers": replaced("time", np.arange(41)), "time matrix": replaced("time", np.zeros((41, 2))),
    "time scalar": replaced("time", 1.0), "time short": replaced("time", np.arange(5.0)), "time complex": replaced("time", np.zeros(41, complex)),
    "time compound": replaced("time", np.zeros(41, [("a", float), ("b", float)])), "time opaque": replaced("time", np.zeros(41, "V8")),
    "time objects": replaced("time", ["a"] * 41, dtype=h5py.string_dtype()), "time empty": lambda f: (without("time")(f), f.create_dataset("time", data=h5py.Empty("f8")))[0],
    "time huge": lambda f: (without("time")(f), f.create_dataset("time", (2**50,), "f8", chunks=(512,)))[0],
    "time and progress huge": lambda f: (without("time")(f), f.create_dataset("time", (2**50,), "f8", chunks=(512,)), filled("progress", 0, 2**50)(f))[0],
    "twist width": replaced(T, np.zeros((41, 5))), "twist flat": replaced(T, np.zeros(41)), "twist 3-d": replaced(T, np.zeros((41, 6, 2))), "twist group": lambda f: (without(T)(f), f.create_group(T))[0],
    "twist huge rows": lambda f: (without(T)(f), f.create_dataset(T, (41, 2**40), "f8", chunks=(1, 1024)))[0],
    "position width": replaced("object/position", np.zeros((41, 4))), "quaternion zero": filled("object/quaternion_xyzw", slice(None), 0.0),
    "joint width": replaced("arms/left/joint_position", np.zeros((41, 2))), "arms/left file": lambda f: (without("arms/left")(f), f.create_dataset("arms/left", data=1.0))[0],
    "external link": linked("time", h5py.ExternalLink("/etc/passwd", "/time")), "external link to itself": linked("time", h5py.ExternalLink("stored.h5", "/time")),
    "external link to nobody": linked(T, h5py.ExternalLink("nobody.h5", "/x")), "soft link to nobody": linked(T, h5py.SoftLink("/nobody")),
    "soft link to itself": linked(T, h5py.SoftLink(f"/{T}")), "soft link to a group": linked(T, h5py.SoftLink("/arms")), "soft link to the root": linked("arms/left", h5py.SoftLink("/")),
    "scene external": linked("scene", h5py.ExternalLink("/etc/passwd", "/scene")), "scene number": replaced("scene", 7), "scene list": replaced("scene", ["a", "b"]),
    "scene empty": replaced("scene", ""), "scene text": replaced("scene", "hello"), "scene bytes": replaced("scene", np.bytes_(b"\xff\xfe")),
    "scene cut": lambda f: replaced("scene", f["scene"].asstr()[()][:60])(f), "scene deep": replaced("scene", "[" * 50_000), "scene laughs": replaced("scene", LAUGHS),
    "scene list of YAML": replaced("scene", "[1, 2]"), "scene object": replaced("scene", "!!python/object/apply:os.system [ls]"),
    "scene megabyte": replaced("scene", "x: " + "y" * 1_000_000), "scene nan": replaced("scene", "gravity: [.nan, 0, 0]"), "scene group": lambda f: (without("scene")(f), f.create_group("scene"))[0],
    "scene robot gone": lambda f: replaced("scene", f["scene"].asstr()[()].replace("textbook_6r", "nobody"))(f), "scene other arms": lambda f: replaced("scene", f["scene"].asstr()[()].replace("left", "west"))(f),
    "outcome text": outcome(lambda d: "hello"), "outcome list": outcome(lambda d: [1]), "outcome null": outcome(lambda d: None), "outcome empty": outcome(lambda d: {}),
    "outcome status": outcome(lambda d: {**d, "status": "gone"}), "outcome status list": outcome(lambda d: {**d, "status": [1]}), "outcome message": outcome(lambda d: {**d, "message": 5}),
    "outcome without message": outcome(lambda d: {"status": "completed"}), "outcome extra": outcome(lambda d: {**d, "extra": 1}), "outcome statistics": outcome(lambda d: {**d, "statistics": 5}),
    "outcome events": outcome(lambda d: {**d, "events": 5}), "outcome events of texts": outcome(lambda d: {**d, "events": ["a"]}), "outcome event without time": outcome(lambda d: {**d, "events": [{"kind": "x"}]}),
    "outcome certificate": outcome(lambda d: {**d, "certificate": "good"}), "outcome nan": outcome(lambda d: json.dumps({**d, "statistics": {"steps": math.nan}})),
    "outcome deep": outcome(lambda d: "[" * 50_000), "outcome UTF-8": outcome(lambda d: '"\u00fc"'), "outcome numbers": replaced("outcome", np.arange(100)),
    "provenance list": edited("provenance", lambda d: [1], True), "provenance cut": edited("provenance", lambda d: "{", True), "provenance deep": edited("provenance", lambda d: "[" * 50_000, True),
    "provenance null": edited("provenance", lambda d: None, True), "provenance number": edited("provenance", lambda d: "1e999", True),
}  # fmt: skip
RUNS_VALID = {"time integers", "columns megabyte", "quaternion zero", "scene other arms"}  # runs that can be looked at all the same


def about(edit: Callable[[Any], Any]) -> Callable[[dict[str, bytes]], None]:
    """What a sweep says of itself, edited."""

    def change(files: dict[str, bytes]) -> None:
        new = edit(json.loads(files["about.json"]))
        files["about.json"] = (new if isinstance(new, str) else json.dumps(new)).encode()

    return change


def content(name: str, data: bytes | str | None) -> Callable[[dict[str, bytes]], None]:
    """A file of a sweep with another content; without it where there is none."""

    def change(files: dict[str, bytes]) -> None:
        del files[name]
        if data is not None:
            files[name] = data.encode() if isinstance(data, str) else data

    return change


def part(edit: Callable[[pa.Table], pa.Table]) -> Callable[[dict[str, bytes]], None]:
    """The rows of a sweep, edited."""

    def change(files: dict[str, bytes]) -> None:
        sink = io.BytesIO()
        parquet.write_table(edit(parquet.read_table(io.BytesIO(files[PART]))), sink)
        files[PART] = sink.getvalue()

    return change


def with_column(name: str, values: list) -> Callable[[dict[str, bytes]], None]:
    """The rows with other values in a column."""
    return part(lambda t: t.set_column(t.column_names.index(name), name, pa.array(values)))


PART = "parts/0.parquet"
FIELDS = ("count", "columns", "fingerprint", "folder", "files", "provenance")
SWEEPS: dict[str, Callable[[dict[str, bytes]], Any]] = {
    **{f"without {name}": content(name, None) for name in ("scene.yaml", "sweep.yaml", "about.json")},
    **{f"about {name} {named(repr(value))}": about(lambda d, n=name, v=value: {**d, n: v}) for name in ("format", "version", *FIELDS) for value in (None, 7, "x", [1.5], {}, -1)},
    **{f"about without {name}": about(lambda d, n=name: {k: v for k, v in d.items() if k != n}) for name in FIELDS},
    "about text": about(lambda d: "hello"), "about list": about(lambda d: [1]), "about deep": about(lambda d: "[" * 50_000), "about bytes": content("about.json", b"\xff\xfe"),
    "column group": about(lambda d: {**d, "columns": [{**c, "group": "nobody"} for c in d["columns"]]}), "column extra": about(lambda d: {**d, "columns": [{**c, "x": 1} for c in d["columns"]]}),
    "column twice": about(lambda d: {**d, "columns": d["columns"] + d["columns"]}), "columns none": about(lambda d: {**d, "columns": []}),
    "part empty": content(PART, b""), "part text": content(PART, "hello"), "part zeros": content(PART, b"\0" * 4096),
    "run negative": with_column("run", [-5, 2, 3, 4]), "run large": with_column("run", [10**12, 2, 3, 4]), "run text": with_column("run", ["a"] * 4),
    "status numbers": with_column("status", [[1]] * 4), "quantity text": with_column("energy_balance", ["a"] * 4), "quantity list": with_column("energy_balance", [[1.0]] * 4),
    "part without a column": part(lambda t: t.drop_columns(["status"])),
    "sweep text": content("sweep.yaml", "hello"), "sweep empty": content("sweep.yaml", ""), "sweep deep": content("sweep.yaml", "[" * 50_000),
    "scene text": content("scene.yaml", "hello"), "scene deep": content("scene.yaml", "[" * 50_000), "scene bytes": content("scene.yaml", b"\xff\xfe"),
}  # fmt: skip
SWEEPS_VALID = {"about fingerprint 'x'", "about files {}", "about provenance {}", "about folder 'x'"}


def changed_sweep(change: Callable[[dict[str, bytes]], Any]) -> Callable[[Path], Any]:
    """A stored sweep in which something was changed."""

    def make(folder: Path) -> Any:
        files = dict(stored_sweep())
        change(files)
        for name, data in files.items():
            (folder / "s.sweep" / name).parent.mkdir(parents=True, exist_ok=True)
            put(folder / "s.sweep" / name, data)
        return _swept(folder / "s.sweep")

    return make


def other_files(use: Callable[[Path], Any]) -> Iterator[tuple[str, Callable[[Path], Any]]]:
    """Files that are something else."""

    def file_of(content: bytes) -> Callable[[Path], Any]:
        return lambda folder: use(put(folder / "stored.h5", content))

    def foreign(folder: Path) -> Any:
        with h5py.File(folder / "stored.h5", "w") as file:
            file["x"] = np.arange(3)
        return use(folder / "stored.h5")

    def place(prepare: Callable[[Path], Any]) -> Callable[[Path], Any]:
        def make(folder: Path) -> Any:
            prepare(folder / "stored.h5")
            return use(folder / "stored.h5")

        return make

    yield "empty", file_of(b"")
    yield "text", file_of(b"hello\n")
    yield "signature alone", file_of(b"\x89HDF\r\n\x1a\n")
    yield "zeros", file_of(b"\0" * 4096)
    yield "another HDF5 file", foreign
    yield "none", place(lambda path: None)
    yield "a folder", place(Path.mkdir)
    yield "a link to itself", place(lambda path: path.symlink_to(path))
    yield "a pipe", place(os.mkfifo)
    yield "a device", lambda folder: use(Path("/dev/zero"))
    yield "a long name", lambda folder: use(folder / ("x" * 5000))
    yield "a closed file", place(lambda path: put(path, b"x").chmod(0))


def stored_cases(count: int, seed: int = 4) -> Iterator[Case]:
    for name, change in RUNS.items():
        yield Case("stored run", name, damaged(change, stored_run, _used), name not in RUNS_VALID)
    for name, make in other_files(_used):
        yield Case("stored run", name, make)
    for k in range(count):
        rng = random.Random(1000 * seed + k)
        yield Case("stored run at random", str(k), bytes_changed(rng, stored_run, _used), False)
    for name, change in SWEEPS.items():
        yield Case("stored sweep", name, changed_sweep(change), name not in SWEEPS_VALID)
    for name, make in other_files(_swept):
        yield Case("stored sweep", name, make)
    for k, name in enumerate(RUNS):
        if k % 4 == 0:
            command = ("replay", "report")[k % 8 == 0]
            option = {"replay": "--html", "report": "--out"}[command]
            shown = lambda path, c=command, o=option: [c, path, o, path.with_suffix(".html")]  # noqa: E731
            yield Case("command on a stored run", name, damaged(RUNS[name], stored_run, shown), False)
    for command, option in (("replay", "--html"), ("report", "--out")):
        for name, make in other_files(lambda path, c=command, o=option: [c, path, o, path.with_name("page.html")]):
            yield Case("command on a stored run", f"{command} {name}", make)


# --- meshes --------------------------------------------------------------------------------------


def stl(count: int | None = None, bad: float | None = None) -> bytes:
    """A tetrahedron as binary STL that may declare another number of triangles."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    triangles = corners[np.array(faces)]
    if bad is not None:
        triangles[1, 1, 1] = bad
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *t.ravel(), 0) for t in triangles)
    return b"\0" * 80 + struct.pack("<I", len(faces) if count is None else count) + body


COLLADA = "<COLLADA><library_geometries/></COLLADA>"
MESHES: dict[str, tuple[str, bytes | None]] = {
    "missing": ("x.stl", None), "empty": ("x.stl", b""), "text": ("x.stl", b"hello"), "zeros": ("x.stl", b"\0" * 500),
    "cut": ("x.stl", stl()[:120]), "4e9 triangles": ("x.stl", stl(4_000_000_000)), "more triangles": ("x.stl", stl(1000)),
    "no triangles": ("x.stl", stl(0)), "nan": ("x.stl", stl(bad=math.nan)), "inf": ("x.stl", stl(bad=math.inf)), "huge": ("x.stl", stl(bad=3e38)),
    "ascii cut": ("x.stl", b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0"), "ascii nan": ("x.stl", b"solid x\nfacet normal 0 0 1\nouter loop\nvertex nan 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"),
    "obj text": ("x.obj", b"hello"), "obj index": ("x.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99\n"), "obj nan": ("x.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    "obj empty": ("x.obj", b""), "obj points": ("x.obj", b"v 0 0 0\nv 1 1 1\n"), "obj negative": ("x.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -9 -8 -7\n"),
    "collada text": ("x.dae", b"hello"), "collada empty": ("x.dae", COLLADA.encode()), "collada entities": ("x.dae", BOMB.replace("robot", "COLLADA").encode()),
    "collada deep": ("x.dae", b"<COLLADA>" + b"<a>" * 60_000 + b"</a>" * 60_000 + b"</COLLADA>"),
    "unknown ending": ("x.xyz", b"hello"), "no ending": ("x", stl()), "gltf": ("x.gltf", b"{}"), "ply": ("x.ply", b"ply\nformat ascii 1.0\nelement vertex 4000000000\nend_header\n"),
}  # fmt: skip


def mesh_cases() -> Iterator[Case]:
    for name, (file, content) in MESHES.items():
        yield Case("mesh of the object", name, _object_mesh(file, content), False)
        yield Case("mesh of a robot", name, _visual_mesh(file, content), False)
        if file.endswith((".stl", ".obj")):
            yield Case("mesh of a body", name, _body_mesh(file, content))


def _object_mesh(file: str, content: bytes | None) -> Callable[[Path], Any]:
    shape = f"mesh: {{file: {file}}}"
    text = SCENE.replace("cylinder: {radius: 0.2, height: 0.05}", shape).replace(
        "mass: 3.0", "mass: 3.0\n  inertia: [0.1, 0.1, 0.1]"
    )
    return _shown(text, URDF, file, content)


def _visual_mesh(file: str, content: bytes | None) -> Callable[[Path], Any]:
    urdf = URDF.replace('<box size="0.4 0.052 0.028"/>', f'<mesh filename="{file}"/>')
    return _shown(SCENE, urdf, file, content)


def _body_mesh(file: str, content: bytes | None) -> Callable[[Path], Any]:
    def make(folder: Path) -> list[Any]:
        if content is not None:
            put(folder / file, content)
        return ["grasp", "design", folder / file, "--out", folder / "scene.yaml"]

    return make


def _shown(text: str, urdf: str, file: str, content: bytes | None) -> Callable[[Path], Any]:
    """The replay of a short run, with the mesh that is to be drawn."""

    def make(folder: Path) -> list[Any]:
        if content is not None:
            put(folder / file, content)
        scene = scene_file(folder, text, urdf)
        run = ["run", scene, "--duration", 0.01, "--quiet", "--no-certificate"]
        return [*run, "--out", folder / "run.h5", "--replay-html", folder / "replay.html"]

    return make


# --- the command line ----------------------------------------------------------------------------


def command_cases() -> Iterator[Case]:
    def case(name: str, words: Callable[[Path], list[Any]], refused: bool = True, heavy: bool = False):
        return Case("command line", name, words, refused, heavy)

    def on_scene(*words: Any) -> Callable[[Path], list[Any]]:
        return lambda folder: ["run", scene_file(folder), "--out", folder / "out.h5", *words]

    for option in ("duration", "accuracy", "output-step", "tolerance", "step", "most-steps"):
        for value in ("nan", "inf", "1e400", "-1", "0", "x", "", "-inf", "1e999999", "0x10"):
            yield case(f"--{option} {value}", on_scene(f"--{option}", value))
    for words in (
        ("--duration", "1e300"), ("--duration", "1e10"), ("--output-step", "1e-300"), ("--output-step", "1e-12"),
        ("--integrator", "rk4", "--step", "1e-300"), ("--integrator", "rk4", "--step", "1e-15"), ("--integrator", "nobody"),
        ("--integrator", "rk4"), ("--solver", ""), ("--arms", "nobody"), ("--nobody",), ("--duration",), ("further",),
    ):  # fmt: skip
        yield case(" ".join(words), on_scene(*words))

    def place(prepare: Callable[[Path], Any]) -> Callable[[Path], Path]:
        def made(folder: Path) -> Path:
            prepare(folder / "odd.yaml")
            return folder / "odd.yaml"

        return made

    odd: dict[str, Callable[[Path], Any]] = {
        "long": lambda folder: folder / ("x" * 5000), "very long": lambda folder: folder / ("/".join(["x" * 200] * 50)),
        "itself": place(lambda path: path.symlink_to(path)), "zeros": lambda folder: "/dev/zero", "full": lambda folder: "/dev/full",
        "nothing": lambda folder: "/dev/null", "pipe": place(os.mkfifo), "folder": place(Path.mkdir), "empty": lambda folder: "",
        "not UTF-8": lambda folder: os.fsdecode(bytes(folder) + b"/\xff.yaml"), "NUL": lambda folder: f"{folder}/a\0b",
        "below a file": lambda folder: put(folder / "file", "x") / "below", "no folder": lambda folder: folder / "none" / "x",
        "nobody's home": lambda folder: "~nobody_there/x", "control": lambda folder: folder / "a\x1b[31mb", "dot": lambda folder: ".",
        "closed folder": lambda folder: "/proc/x", "directory of processes": lambda folder: "/proc/self/mem",
    }  # fmt: skip
    for name, path in odd.items():
        heavy = name in ("zeros", "pipe")
        for words in (["check"], ["run", "--out", "OUT"], ["pose"], ["grasp", "check"], ["grasp", "design"]):
            def read(folder: Path, w: Any = words, p: Any = path) -> list[Any]:
                return [folder / "out.h5" if word == "OUT" else word for word in w] + [p(folder)]
            yield case(f"{' '.join(words)} reads {name}", read, heavy=heavy)
        yield case(f"sweep over {name}", lambda f, p=path: ["sweep", scene_file(f), "--over", p(f), "--out", f / "o.h5"], heavy=heavy)
        if name not in ("not UTF-8", "control", "nothing"):
            yield case(f"run --out {name}", lambda f, p=path: ["run", scene_file(f), "--out", p(f)])
            yield case(f"check --json {name}", lambda f, p=path: ["check", scene_file(f), "--json", p(f)])
            yield case(f"run --replay-html {name}", lambda f, p=path: ["run", scene_file(f), "--out", f / "o.h5", "--replay-html", p(f)])
    sweeps = ("--workers", "--repeat", "--seed")
    for option in sweeps:
        for value in ("0", "-1", "x", "1e3", "", "nan", "9" * 30, "9" * 5000):
            if option == "--seed" and value in ("0", "9" * 30):
                continue
            yield case(f"sweep {option} {named(value)}", lambda f, o=option, v=value: [*swept(SWEEP)(f), o, v])
    yield case("sweep of 1e9 runs", swept("over: {object.mass: {linspace: [1, 2, 1000000000]}}"))
    yield case("sweep of 1e18 runs", swept("over: {object.mass: {linspace: [1, 2, 1000000000]}, effects.joint_damping: {linspace: [1, 2, 1000000000]}}"))
    yield case("sweep repeated 1e12", swept("over: {object.mass: {uniform: [1, 2]}}\nrepeat: 1000000000000"))
    yield case("sweep of a hypercube of 1e8", swept("over: {object.mass: {uniform: [1, 2]}}\nrepeat: 100000000\nsampling: latin_hypercube"), heavy=True)
    yield case("sweep seed huge", swept(SWEEP.replace("seed: 3", "seed: " + "9" * 4000)), False)
    yield case("replay --fps nan", lambda f: ["replay", put(f / "r.h5", stored_run()), "--html", f / "r.html", "--fps", "nan"])
    yield case("replay --fps 1e300", lambda f: ["replay", put(f / "r.h5", stored_run()), "--html", f / "r.html", "--fps", "1e300"], False)
    yield case("replay --speed 1e300", lambda f: ["replay", put(f / "r.h5", stored_run()), "--html", f / "r.html", "--speed", "1e300"], False)
    yield case("replay --speed 1e-300", lambda f: ["replay", put(f / "r.h5", stored_run()), "--html", f / "r.html", "--speed", "1e-300"], False)
    yield case("replay --host nobody", lambda f: ["replay", put(f / "r.h5", stored_run()), "--no-open", "--host", "no.body.invalid"])
    yield case("replay --port 1", lambda f: ["replay", put(f / "r.h5", stored_run()), "--no-open", "--host", "192.0.2.1", "--port", "1"])
    for body in ("box:1,1", "box:nan,1,1", "box:1e300,1,1", "box:0,1,1", "box:-1,1,1", "box:", "box", "prism:1e9,1,1", "prism:nan,1,1", "prism:3.5,1,1", "prism:inf,1,1", "wedge:1,1,1,9", "pyramid:3,0,1", "sphere:1", "x" * 5000, "", "box:1e-300,1,1", "box:1,1,1,1"):  # fmt: skip
        yield case(f"grasp design {named(body)}", lambda f, b=body: ["grasp", "design", b, "--out", f / "s.yaml"])
    for words in (["--mass", "nan"], ["--mass", "-1"], ["--duration", "inf"], ["--tip-radius", "nan"], ["--height", "nan"], ["--offset", "nan"], ["--gripper-size", "-1"], ["--scale", "nan"], ["--seed", "-1"], ["--arms", "nobody", "panda"], ["--gap", "nan", "--optimise", "margin"]):  # fmt: skip
        yield case(f"grasp design {' '.join(words)}", lambda f, w=words: ["grasp", "design", "box:1.2,0.8,0.6", *w, "--out", f / "s.yaml"])
    for words in (["nobody"], ["run"], ["grasp", "nobody"], ["joints", "nobody"], ["methods", "x"], ["new", "--robot", "nobody"], ["schema", "nobody"], ["stability", "nobody"], ["effects", "--rounds", "0"], ["accuracy", "--from", "/dev/null"], ["new", "/dev/full"], ["warmup", "--workers", "0"]):  # fmt: skip
        yield case(" ".join(words), lambda f, w=words: list(w))


# --- Python --------------------------------------------------------------------------------------


@cache
def system() -> Any:
    import tempfile

    folder = Path(tempfile.mkdtemp())
    try:
        return ma.compile_system(ma.load_scene(scene_file(folder)))
    finally:
        shutil.rmtree(folder)


def call_cases() -> Iterator[Case]:
    def case(name: str, call: Callable[[], Any], refused: bool = True) -> Case:
        return Case("call", name, lambda folder: call, refused)

    s = system
    scene = lambda: s().scene  # noqa: E731
    start = lambda: s().initial_state()  # noqa: E731
    arm = "left"
    for what, value in {"a path": "scene.yaml", "a table": {"a": 1}, "None": None, "a number": 5, "a long text": "x" * 100_000}.items():  # fmt: skip
        for name in ("simulate", "compile_system", "evaluate", "inverse_dynamics", "Stepper", "replay", "report", "simulate_many", "sweep"):
            further = {"report": ("x.html",), "sweep": ({"object.mass": [1]},), "inverse_dynamics": (None, np.zeros(6))}
            arguments: tuple = further.get(name, ())
            yield case(f"{name}({what})", lambda n=name, v=value, a=arguments: getattr(ma, n)(v, *a))
        if what != "a path":
            for name in ("load_scene", "load_trajectory", "load_sweep"):
                yield case(f"{name}({what})", lambda n=name, v=value: getattr(ma, n)(v))
    for name in ("simulate", "evaluate", "inverse_dynamics", "Stepper", "replay", "simulate_many"):
        arguments = (None, np.zeros(6)) if name == "inverse_dynamics" else ()
        yield case(f"{name}(scene)", lambda n=name, a=arguments: getattr(ma, n)(scene(), *a))
    yield case("compile_system(system)", lambda: ma.compile_system(s()))
    yield case("load_scene(scene)", lambda: ma.load_scene(scene()))
    yield case("evaluate(system, state)", lambda: ma.evaluate(s(), start()))
    yield case("evaluate(system, state, t)", lambda: ma.evaluate(s(), start(), 0.0))
    for what, value in {"nan": math.nan, "inf": math.inf, "text": "x", "list": [0.0], "None": None}.items():
        yield case(f"evaluate(system, {what})", lambda v=value: ma.evaluate(s(), v))
        yield case(f"simulate(duration={what})", lambda v=value: ma.simulate(s(), duration=v), (what == "None" and False) or what != "None")
        yield case(f"simulate(max_step={what})", lambda v=value: ma.simulate(s(), duration=0.01, max_step=v), what not in ("None", "inf"))
        yield case(f"simulate(output_step={what})", lambda v=value: ma.simulate(s(), duration=0.01, output_step=v), what != "None")
        yield case(f"simulate(sample_time={what})", lambda v=value: ma.simulate(s(), duration=0.01, control=lambda t, x: {}, sample_time=v), what != "None")
        yield case(f"Stepper.advance({what})", lambda v=value: ma.Stepper(s()).advance(v))
        yield case(f"state(position={what})", lambda v=value: s().state(object_position=v), what != "None")
        yield case(f"state(joints={what})", lambda v=value: s().state(joint_positions=v), what != "None")
        yield case(f"state(joints of an arm={what})", lambda v=value: s().state(joint_positions={arm: v}))
        yield case(f"simulate(state={what})", lambda v=value: ma.simulate(s(), duration=0.01, state=v), what != "None")
        yield case(f"evaluate(state={what})", lambda v=value: ma.evaluate(s(), 0.0, v), what != "None")
        yield case(f"control gives {what}", lambda v=value: ma.simulate(s(), duration=0.01, control=lambda t, x: v))
        yield case(f"control of an arm gives {what}", lambda v=value: ma.simulate(s(), duration=0.01, control=lambda t, x: {arm: v}))
        yield case(f"compile_system(control={what})", lambda v=value: ma.compile_system(scene(), v), what != "None")
        yield case(f"simulate(control={what})", lambda v=value: ma.simulate(s(), duration=0.01, control=v), what != "None")
    yield case("simulate(duration=1e300)", lambda: ma.simulate(s(), duration=1e300))
    yield case("simulate(output_step=1e-12)", lambda: ma.simulate(s(), output_step=1e-12))
    yield case("simulate(step=1e-300)", lambda: ma.simulate(s(), integrator="rk4", step=1e-300))
    yield case("control gives a wrong shape", lambda: ma.simulate(s(), duration=0.01, control=lambda t, x: {arm: np.zeros((2, 2))}))
    yield case("control gives too many", lambda: ma.simulate(s(), duration=0.01, control=lambda t, x: {arm: np.zeros(100_000)}))
    yield case("control gives NaN", lambda: ma.simulate(s(), duration=0.01, control=lambda t, x: {arm: [math.nan, 0.0]}))
    yield case("control names nobody", lambda: ma.simulate(s(), duration=0.01, control=lambda t, x: {"nobody": [0.0, 0.0]}))
    yield case("control takes one argument", lambda: ma.simulate(s(), duration=0.01, control=lambda t: {}))
    yield case("control raises", lambda: ma.simulate(s(), duration=0.01, control=lambda t, x: 1 / 0))
    yield case("state without arms", lambda: s().state(joint_positions={"nobody": [0, 0]}))
    yield case("state of 2 x 2", lambda: s().state(joint_positions={arm: np.zeros((2, 2))}))
    yield case("state nan", lambda: s().state(joint_positions={arm: [math.nan, 0]}))
    yield case("state megabyte", lambda: s().state(object_position=["x" * 1_000_000]))
    yield case("state quaternion zero", lambda: s().state(object_quaternion_xyzw=[0, 0, 0, 0]))
    yield case("state quaternion huge", lambda: s().state(object_quaternion_xyzw=[1e300, 1e300, 0, 0]), False)

    def with_nan() -> Any:
        state = start()
        state.position[0] = math.nan
        return state

    def of_another() -> Any:
        block = ma.compile_system(ma.Scene(**yaml.safe_load(_stored_scene())))
        return block.initial_state()

    for name, call in {"simulate": lambda x: ma.simulate(s(), duration=0.01, state=x), "evaluate": lambda x: ma.evaluate(s(), 0.0, x), "Stepper": lambda x: ma.Stepper(s(), state=x), "inverse_dynamics": lambda x: ma.inverse_dynamics(s(), x, np.zeros(6))}.items():  # fmt: skip
        yield case(f"{name}(a state with NaN)", lambda c=call: c(with_nan()))
        yield case(f"{name}(a state of another system)", lambda c=call: c(of_another()))
        yield case(f"{name}(an array)", lambda c=call: c(np.zeros(11)))
    yield case("Scene()", lambda: ma.Scene())
    yield case("Scene(1)", lambda: ma.Scene(1))
    yield case("Scene(nobody=...)", lambda: ma.Scene(nobody=1))
    yield case("with_solver(x)", lambda: s().with_solver("x"))
    yield case("compile_system(arms=x)", lambda: ma.compile_system(scene(), arms="x"))
    yield case("simulate(integrator=5)", lambda: ma.simulate(s(), integrator=5))
    yield case("simulate(out=5)", lambda: ma.simulate(s(), duration=0.01, out=5))
    yield case("simulate(progress=5)", lambda: ma.simulate(s(), duration=0.01, progress=5))


def all_cases(scale: int = 1) -> list[Case]:
    """All inputs; ``scale`` multiplies the random ones."""
    return [
        *yaml_cases(),
        *random_scene_cases(100 * scale),
        *random_sweep_cases(40 * scale),
        *robot_cases(30 * scale),
        *stored_cases(40 * scale),
        *mesh_cases(),
        *command_cases(),
        *call_cases(),
    ]
