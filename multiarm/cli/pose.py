"""``multiarm pose``: the joint positions that a scene leaves to the program."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

from multiarm.cli.files import check_targets, scene_to_inspect, write_text
from multiarm.cli.options import Code, SceneFile, switch
from multiarm.errors import SceneError
from multiarm.terminal.console import output, print_written

__all__ = ["pose"]


def pose(
    scene: SceneFile,
    write: Annotated[
        bool, switch("--write", "Write the positions into the file; all else stays as it is.")
    ] = False,
    code: Code = False,
) -> None:
    """Find postures for the arms of a scene that have none, or `posture: solve`.

    Printed are joint positions from base to tip, in rad, of sliding joints in m, as a scene has
    them. An arm that reaches its place on the object from nowhere is an error, which says how near
    it comes and where to move its base.
    """
    if write:
        check_targets({"SCENE": scene})
    from multiarm.scene.values import SOLVE

    loaded = scene_to_inspect(scene, code)
    open_ones = [name for name, arm in loaded.arms.items() if arm.posture in (None, SOLVE)]
    if not open_ones:
        raise SceneError(f"'{scene}' gives every arm a posture; write 'posture: solve' to find one")
    from multiarm.assembly.compilation import compile_for_inspection

    system, _ = compile_for_inspection(loaded)
    positions = system.initial_state().joint_positions
    found = {name: _written(positions[name]) for name in open_ones}
    if not write:
        for name, text in found.items():
            output().print(f"{name}: {{posture: {text}}}", markup=False, soft_wrap=True)
        return
    from multiarm.scene.text import with_values

    given = scene.read_text(encoding="utf-8")
    changed = with_values(given, {("arms", name, "posture"): text for name, text in found.items()})
    write_text(scene, changed, "SCENE")
    print_written("scene", scene)


def _written(posture: Iterable[float]) -> str:
    """A list of numbers as YAML, to a hundredth of a microradian or nanometres."""
    return f"[{', '.join(f'{q:.8f}'.rstrip('0').rstrip('.') for q in posture)}]"
