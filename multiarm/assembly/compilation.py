"""Compilation: from a scene to a system.

:func:`compile_system` is the sequence of its steps.  Arms, joints and arm dynamics are constants:
those that another system (``like``) has too are shared with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from multiarm.assembly.joints import contact_rows, joint_frames, scene_joints
from multiarm.assembly.model import uncontrolled_model, with_control, with_joint_frames
from multiarm.assembly.paths import joint_path
from multiarm.assembly.placed_objects import with_object_poses
from multiarm.assembly.robots import backends_of, load_robots, with_bases
from multiarm.assembly.start import (
    assembled_start,
    closed_at_start,
    held_at_start,
    unassembled_start,
    with_contacts_located,
    written_start,
)
from multiarm.assembly.start_warnings import start_warnings
from multiarm.control.laws import control_program
from multiarm.control.program import ControlContext, ControlProgram, JointPath
from multiarm.dynamics.callbacks import ControlFunction
from multiarm.dynamics.data import Data
from multiarm.dynamics.state import State
from multiarm.dynamics.system import StartReport, System, require_control
from multiarm.errors import ModelError, SceneError
from multiarm.integration.explicit import explicit_step
from multiarm.integration.step import write_slope
from multiarm.integration.time_loop import advance
from multiarm.jit.ahead import compile_ahead
from multiarm.scene import (
    ARM_TERMS,
    NamedCode,
    Scene,
    Waypoint,
    with_code,
    without_code,
)
from multiarm.scene.faults import shown


def compile_system(
    scene: Scene,
    control: ControlFunction | None = None,
    *,
    sample_time: float | None = None,
    sample_delay: bool = False,
    arms: str | None = None,
    like: System | None = None,
    code: bool | None = None,
    assemble: bool = True,
) -> System:
    """Build the system that a scene describes; only what the scene names is in it.

    Parameters
    ----------
    scene : Scene
    control : callable, optional
        ``f(t, state) -> {arm: torques}`` in place of the scene's control; arms that it leaves out
        get no torque.
    sample_time, sample_delay
        Of ``control``: it is called every ``sample_time`` [s] only, see
        :meth:`multiarm.System.with_control`.  A control of the scene has keys of these names.
    arms : {"pinocchio", "compiled"}, optional
        Backend of the arm dynamics, in place of ``run.arms`` of the scene.
    like : System, optional
        Of a similar scene: equal arms and joints are shared, and their URDFs are not read again.
        The result is the same.
    code : bool, optional
        Whether functions and effects of packages that the scene names may be loaded, which runs
        their code.  By default as the scene was read: allowed for scene files, unless
        ``load_scene`` forbade it, and not for stored results.
    assemble : bool
        False: the start is as written, gaps and all, and postures are not sought.  Such a system
        can be evaluated; runs need a ``state`` that satisfies the joints.

    Raises
    ------
    SceneError
        When the start does not satisfy the joints and is too far from doing so; when the scene
        names code and may not load any.
    ModelError
        When a robot cannot be used, a function cannot be loaded, or a compiled arm is not the
        robot's.
    ControlError
        When ``sample_time`` cannot be used.
    """
    require_control(control, sample_time, sample_delay)
    if not isinstance(scene, Scene):
        raise SceneError(
            f"a scene is needed, got {shown(scene)}; read its file with ma.load_scene(path), or "
            "make a table a scene: ma.Scene(**table)"
        )
    scene = with_code(_with_arms(scene, arms), code).with_trunk_robots()
    scene = with_object_poses(scene)  # objects that are where their joints put them
    scene = with_bases(scene) if assemble else scene  # where arms stand, if that is to be found
    # a run needs them: the first time they are compiled in the background
    compile_ahead(advance, explicit_step, write_slope)
    robots = load_robots(scene, like, assemble)  # URDF -> arms with tips and limits
    joints = scene_joints(scene, robots, like)  # contact records of every joint
    rows = contact_rows(scene, robots, joints)  # all rows of W, unilateral ones too
    backends = backends_of(scene, robots, like)  # Pinocchio or compiled copies
    data = Data(uncontrolled_model(scene, robots, joints, rows, backends))
    written = written_start(scene, robots, rows.layout)
    data = with_contacts_located(data, closed_at_start(data) if assemble else data, written)
    if assemble:
        start, report = assembled_start(scene, data, written)
        frames = joint_frames(scene, data, start)  # with the motions that each joint leaves free
        data = data.view(with_joint_frames(data.model, frames))
    else:
        start, report = unassembled_start(data, written)
    model = data.model
    if control is None:
        model = with_control(model, control_law(scene, data, start))
    system = System(scene, model, report, start, start_warnings if assemble else None)
    if model.reads_inertias == data.model.reads_inertias:  # else it has other terms of the robots
        system.keep(data.view(model))
    return system if control is None else system.with_control(control, sample_time, sample_delay)


def compile_for_inspection(scene: Scene, arms: str | None = None) -> tuple[System, list[NamedCode]]:
    """Build a system without the code that the scene names, and list that code.

    Where joints lack contacts without it, the start is as written, not assembled, the free motions
    of joints are those that their kinds fix, and there is no control.

    Raises
    ------
    SceneError, ModelError
        See :func:`compile_system`.
    """
    scene, left = without_code(_with_arms(scene, arms))
    if not any(code.arm for code in left):
        return compile_system(scene), left
    return geometry_of(scene), left


def geometry_of(scene: Scene, start: Mapping[str, Any] | None = None) -> System:
    """Build what says where a scene's arms and contacts are: without control, not assembled.

    The free motions of joints are those that their kinds fix.

    Parameters
    ----------
    scene : Scene
        With its functions loaded, or without what needs them.
    start : mapping, optional
        Arguments of :meth:`multiarm.System.state`, in place of the start as written, for which
        missing postures are sought.
    """
    scene = with_bases(with_object_poses(scene.with_trunk_robots()))
    robots = load_robots(scene, seek=start is None)
    joints = scene_joints(scene, robots)
    rows = contact_rows(scene, robots, joints)
    data = Data(uncontrolled_model(scene, robots, joints, rows, backends_of(scene, robots)))
    written = System(scene, data.model, StartReport(), written_start(scene, robots, rows.layout))
    state = written.state(**start or {})
    return System(scene, with_contacts_located(data, data, state).model, StartReport(), state)


def control_law(scene: Scene, data: Data, start: State) -> ControlProgram:
    """The scene's control, for which all contacts of joints that hold at the start are closed."""
    closed = held_at_start(data)

    def path(paths: Mapping[str, tuple[Waypoint, ...]]) -> JointPath:
        return joint_path(scene, closed, start, paths, compile_system)

    return control_program(ControlContext(scene, closed, start, path, data))


def _with_arms(scene: Scene, arms: str | None) -> Scene:
    """The scene with another backend of the arm dynamics."""
    if arms is None:
        return scene
    if arms not in ARM_TERMS:
        raise ModelError(f"unknown arms {arms!r}; arms are {', '.join(map(repr, ARM_TERMS))}")
    return scene.model_copy(update={"run": scene.run.model_copy(update={"arms": arms})})
