"""What a study has found: its file, and the cheapest setting for each decade of accuracy.

Every point is written as soon as it is measured.  Points that were compared with a first reference
keep their motions, until a better reference comes and their errors are computed again.
An interrupted study resumes from the file, and pages and plots are drawn from it alone.  It belongs
to a scene, to versions and to a machine: times of different machines are not comparable.

A point counts for a level of accuracy when its error plus the reference's digits is within it:
errors that the reference cannot resolve are not ranked.
"""

from __future__ import annotations

import base64
import hashlib
import json
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.errors import MultiarmError
from multiarm.results.files import atomic_output
from multiarm.results.trajectory import plain
from multiarm.scene import Scene, resolve_arm
from multiarm.studies.records import about_scene, accuracies
from multiarm.studies.work_precision.points import Measured, Point
from multiarm.studies.work_precision.reference import Motion, Reference

FORMAT_FAMILY = "multiarm accuracy, "
FORMAT = f"{FORMAT_FAMILY}2"
WRITE_INTERVAL = 1.0
"""The file is written at most so often [s]."""
DEFAULT_FORCE_ACCURACY = 1e-3
"""Target error of contact forces if the scene requests none [N]."""
# How the scene itself is to be run has no influence on the study.
_NO_INFLUENCE = ("accuracy", "integrator", "step", "tolerance", "stabilization", "solver")
_OF_MACHINE = ("processor", "version", "python", "dependencies")
LEVELS = tuple(float(f"1e-{k}") for k in range(1, 14))
CLAIMED = (1e-6, 1e-9)
"""The levels at which we are compared with the best peer."""


class Results:
    """What a study has found so far.

    Attributes
    ----------
    about : dict
        Scene (name, digest, duration_s, output_step_s, text, and accuracy: the error that is aimed
        at, for each quantity) and machine.
    reference : Reference or None
        What points are compared with.
    points : dict of str to Point
        By the setting's key, in the order in which they were measured.
    refusals : dict of str to str
        Peer -> why it has no points.
    wall_time_s : float
        That the study took.
    planned : int or None
        How many points there will be, as far as that is known; None when all are measured.
    expected_s : float
        About how long what is left takes [s], while a study goes on; not stored.
    left_out : bool
        Dominated settings were left out.
    """

    def __init__(self, about: dict[str, Any], path: Path | None = None):
        self.about = about
        self.reference: Reference | None = None
        self.points: dict[str, Point] = {}
        self.refusals: dict[str, str] = {}
        self.wall_time_s = 0.0
        self.planned: int | None = None
        self.expected_s = 0.0
        self.left_out = False
        self._motions: dict[str, Motion] = {}
        self._path, self._written = path, 0.0

    @classmethod
    def of(cls, scene: Scene, machine: Mapping[str, Any], path: Path | None = None) -> Results:
        """Empty results of a scene on this machine."""
        aims = accuracies(scene.run, DEFAULT_FORCE_ACCURACY)
        aims["joints"] = aims["motion"]
        own = {**about_scene(scene), "digest": scene_digest(scene), "accuracy": aims}
        return cls({"scene": own, "machine": plain(machine)}, path)

    def stale(self, other: Results) -> str:
        """Why these results are not those of ``other``'s scene and machine; empty if they are."""
        if self.about["scene"]["digest"] != other.about["scene"]["digest"]:
            return "the scene has changed"
        for key in _OF_MACHINE:
            if self.about["machine"].get(key) != other.about["machine"].get(key):
                return "it is of another machine" if key == "processor" else "versions have changed"
        return ""

    def found_reference(self, reference: Reference) -> None:
        """Keep a reference; points whose motions are known are compared with it."""
        self.reference = reference
        for key, motion in self._motions.items():
            self.points[key] = Measured(self.points[key], motion).against(reference.motion)
        if not reference.first:
            self._motions = {}
        self.write()

    def add(self, measured: Measured) -> None:
        """Keep a run, compared with the reference; the file is written now and then."""
        assert self.reference is not None, "the reference comes first"
        key = measured.point.setting.key
        if self.reference.first and measured.motion is not None:
            self._motions[key] = measured.motion
        self.replace(measured.against(self.reference.motion))

    def replace(self, point: Point) -> None:
        """Keep a point as it is; the file is written now and then."""
        self.points[point.setting.key] = point
        if time.monotonic() - self._written > WRITE_INTERVAL:
            self.write()

    def as_dict(self) -> dict[str, Any]:
        """The results in what JSON knows, without motions."""
        known = None if self.reference is None else vars(self.reference)
        return {
            "format": FORMAT,
            **self.about,
            "reference": known and plain({k: v for k, v in known.items() if k != "motion"}),
            "refusals": self.refusals,
            "wall_time_s": self.wall_time_s,
            "planned": self.planned,
            "left_out": self.left_out,
            "points": [point.as_dict() for point in self.points.values()],
        }

    def write(self) -> None:
        """Write the file, complete or not at all.

        Raises
        ------
        MultiarmError
            It cannot be written.
        """
        self._written = time.monotonic()
        if self._path is None:
            return
        motions = {key: _encoded(motion) for key, motion in self._motions.items()}
        exact = None if self.reference is None else _encoded(self.reference.motion)
        data = {**plain(self.as_dict()), "exact": exact, "motions": motions}
        text = json.dumps(data, allow_nan=False, ensure_ascii=False, indent=1)
        with atomic_output(self._path, "--out") as partial:
            partial.write_text(text + "\n", encoding="utf-8")


def read_results(path: Path) -> Results:
    """Read the file of a study.

    Raises
    ------
    MultiarmError
        There is none, it is something else, or another version of the program wrote it.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MultiarmError(f"cannot read '{path}': {error.strerror}") from None
    except ValueError:
        data = None
    strange = f"'{path}' is not the file of an accuracy study; name another one"
    written = data.get("format") if isinstance(data, dict) else None
    if not isinstance(written, str) or not written.startswith(FORMAT_FAMILY):
        raise MultiarmError(strange)
    if written != FORMAT:
        raise MultiarmError(
            f"'{path}' has the format '{written}' of another version, which lacks what this one "
            f"needs, '{FORMAT}'; name another file, or measure anew: multiarm accuracy SCENE "
            f"--out {path} --fresh"
        )
    try:
        return _read(data, path)
    except (KeyError, TypeError, ValueError):
        raise MultiarmError(strange) from None


def _read(data: dict[str, Any], path: Path) -> Results:
    """The results in a file's data."""
    results = Results({key: data[key] for key in ("scene", "machine")}, path)
    if data["reference"] is not None:
        results.reference = Reference(_decoded(data["exact"]), **data["reference"])
    results.refusals, results.wall_time_s = data["refusals"], data["wall_time_s"]
    found = [Point.from_dict(item) for item in data["points"]]
    results.points = {point.setting.key: point for point in found}
    results.planned, results.left_out = data["planned"], data["left_out"]
    results._motions = {key: _decoded(motion) for key, motion in data["motions"].items()}
    return results


def _encoded(motion: Motion) -> dict[str, Any]:
    """A motion in what JSON knows, all numbers bit for bit."""
    return {
        "rows": len(motion.positions),
        "positions": _text(motion.positions),
        "forces": None if motion.forces is None else _text(motion.forces),
    }


def _text(numbers: np.ndarray) -> str:
    return base64.b64encode(numbers.tobytes()).decode()


def _decoded(data: Mapping[str, Any]) -> Motion:
    """The motion that :func:`_encoded` was given."""

    def numbers(text: str) -> np.ndarray:
        return np.frombuffer(base64.b64decode(text)).reshape(data["rows"], -1)

    forces = data["forces"]
    return Motion(numbers(data["positions"]), None if forces is None else numbers(forces))


def scene_digest(scene: Scene) -> str:
    """A digest of all that the motion and the output times depend on, robots' files included."""
    data = scene.model_dump(mode="json")
    data["run"] = {k: v for k, v in data["run"].items() if k not in _NO_INFLUENCE}
    digest = hashlib.sha256(json.dumps(data, sort_keys=True).encode())
    for arm in scene.arms.values():
        resolved = resolve_arm(arm, scene.folder)
        if arm.tip is None:  # a newer program may know another usual one
            digest.update(resolved.tip.encode())
        for urdf in (resolved.urdf, resolved.tool_urdf):
            if urdf is not None:
                digest.update(urdf.encode() if isinstance(urdf, str) else urdf.read_bytes())
    return digest.hexdigest()[:16]


# --- the cheapest settings ------------------------------------------------------------------------


@dataclass(frozen=True)
class Decade:
    """The cheapest settings for one level of accuracy; None where none reaches it.

    Attributes
    ----------
    level : float
        Largest error.
    ours, peer : Point or None
    """

    level: float
    ours: Point | None
    peer: Point | None

    @property
    def ratio(self) -> float | None:
        """Wall time of the best peer over ours."""
        if self.ours is None or self.peer is None:
            return None
        assert self.ours.wall_time_s and self.peer.wall_time_s, "completed points have a time"
        return self.peer.wall_time_s / self.ours.wall_time_s


@dataclass(frozen=True)
class Series:
    """One method: its points from coarse to fine."""

    name: str
    points: tuple[Point, ...]

    @property
    def ours(self) -> bool:
        """Whether it is a method of this program."""
        return self.points[0].setting.ours

    def best(self, quantity: str) -> Point | None:
        """The point of the least error; None if no point has one."""
        able = [point for point in self.points if point.error(quantity) is not None]
        return min(able, key=lambda point: point.error(quantity) or 0.0, default=None)

    @property
    def failures(self) -> tuple[Point, ...]:
        """Points without a result."""
        return tuple(point for point in self.points if not point.completed)


def all_series(results: Results) -> list[Series]:
    """All methods, ours first, each in the order of its ladder."""
    found: dict[str, list[Point]] = {}
    for point in results.points.values():
        found.setdefault(point.setting.series, []).append(point)
    series = [
        Series(name, tuple(sorted(points, key=lambda point: -point.setting.value)))
        for name, points in found.items()
    ]
    return sorted(series, key=lambda item: not item.ours)


def decades(results: Results, quantity: str = "motion") -> list[Decade]:
    """The cheapest settings for each power of ten down to the digits of the reference."""
    digits = digits_of(results, quantity)
    points = list(results.points.values())
    ours = [point for point in points if point.setting.ours]
    peers = [point for point in points if not point.setting.ours]
    found = [
        Decade(
            level,
            cheapest(ours, level, quantity, digits),
            cheapest(peers, level, quantity, digits),
        )
        for level in LEVELS
        if level > digits
    ]
    return [decade for decade in found if decade.ours or decade.peer]


def cheapest(
    points: Iterable[Point], level: float, quantity: str, digits: float = 0.0
) -> Point | None:
    """The fastest point whose error is within a level; None when there is none."""
    able = (point for point in points if reaches(point, level, quantity, digits))
    return min(able, key=wall_time, default=None)


def reaches(point: Point, level: float, quantity: str, digits: float) -> bool:
    """Whether a point's error is within a level, beyond doubt."""
    error = point.error(quantity) if point.completed else None
    return error is not None and error + digits <= level


def digits_of(results: Results, quantity: str) -> float:
    """The digits of the reference for a quantity."""
    assert results.reference is not None, "a study begins with its reference"
    return results.reference.digits.get(quantity, 0.0)


def wall_time(point: Point) -> float:
    """The time of a completed point [s]."""
    assert point.wall_time_s is not None, "a completed point has a time"
    return point.wall_time_s
