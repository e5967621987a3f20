"""``multiarm pose``: the joint positions that a scene leaves to the program."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Annotated

from multiarm.cli.files import check_targets, scene_to_run
from multiarm.cli.options import NoCode, SceneFile, switch
from multiarm.errors import SceneError
from multiarm.results.files import write_text
from multiarm.terminal.console import output, print_written

if TYPE_CHECKING:
    from multiarm.scene import ArmSpec


def pose(
    scene: SceneFile,
    write: Annotated[
        bool, switch("--write", "Write the positions into the file; all else stays as it is.")
    ] = False,
    no_code: NoCode = False,
) -> None:
    """Find the postures that a scene leaves to the program, and the places to stand.

    Postures are found of arms that have none, or `posture: solve`; places of arms with `base:
    {solve: [x, y, yaw]}`. Printed are joint positions from base to tip, in rad, of sliding joints
    in m, and bases in m and rad, as a scene has them. It is an error if an arm cannot reach its
    place on the object; the message says how near it comes and where to move its base.
    """
    if write:
        check_targets({"SCENE": scene})
    from multiarm.scene.values import SOLVE

    loaded = scene_to_run(scene, no_code)
    open_ones = [name for name, arm in loaded.arms.items() if arm.posture in (None, SOLVE)]
    if not open_ones:
        raise SceneError(f"'{scene}' gives every arm a posture; write 'posture: solve' to find one")
    from multiarm.assembly.compilation import compile_system

    system = compile_system(loaded)
    positions = system.initial_state().joint_positions
    bases = {name: _base(loaded.arms[name], system.scene.arms[name]) for name in open_ones}
    postures = {name: _written(positions[name]) for name in open_ones}
    if not write:
        for name, posture in postures.items():
            base = ", ".join(f"{key}: {text}" for key, text in bases[name].items())
            text = f"base: {{{base}}}, posture: {posture}" if base else f"posture: {posture}"
            output().print(f"{name}: {{{text}}}", markup=False, soft_wrap=True)
        return
    from multiarm.scene.text import with_values, without_entry

    values: dict[Sequence[str], str] = {
        ("arms", name, "posture"): text for name, text in postures.items()
    }
    for name, entries in bases.items():
        values |= {("arms", name, "base", key): text for key, text in entries.items()}
    changed = with_values(scene.read_text(encoding="utf-8"), values)
    for name in filter(bases.get, open_ones):
        changed = without_entry(changed, ("arms", name, "base", "solve"))
    write_text(scene, changed, "SCENE")
    print_written("scene", scene)


def _base(written: ArmSpec, solved: ArmSpec) -> dict[str, str]:
    """The entries of a base that was found; empty where it was written."""
    sought = set(written.open_base)
    parts = {"xyz": sought & {"x", "y", "z"}, "rpy": sought & {"roll", "pitch", "yaw"}}
    return {key: _written(getattr(solved.base, key)) for key, names in parts.items() if names}


def _written(numbers: Iterable[float]) -> str:
    """A list of numbers as YAML, to a hundredth of a microradian or nanometres."""
    return f"[{', '.join(f'{round(x, 8) + 0.0:.8f}'.rstrip('0').rstrip('.') for x in numbers)}]"
