"""An arm as a user writes it: which robot, where it stands, how it starts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field, model_validator
from typing_extensions import Self

from multiarm.scene.base import Pose, Spec, absolute
from multiarm.scene.fingers import FingersSpec
from multiarm.scene.values import Color, JointValues, Number, fault

__all__ = ["ArmSpec", "ToolSpec"]


class _FromUrdf(Spec):
    """A model by name (``robot``) or by file (``urdf``)."""

    robot: str | None = None
    urdf: Path | None = None
    package_dirs: tuple[Path, ...] = ()

    @model_validator(mode="after")
    def _exactly_one_source(self) -> Self:
        sources = self._sources()
        given = [name for name in sources if getattr(self, name) is not None]
        if len(given) != 1:
            told = " or ".join(f"'{name}' ({what})" for name, what in sources.items())
            got = "neither" if not given else "both" if len(given) == 2 else "all"
            raise fault(f"needs either {told}, got {got}")
        return self

    def _sources(self) -> dict[str, str]:
        """Keys of which exactly one says where the model comes from, and what they hold."""
        return {"robot": "a name", "urdf": "a file"}

    def located(self, folder: Path) -> Self:
        """Return this model with file paths made absolute, relative ones below ``folder``."""
        changes: dict[str, Any] = {
            "package_dirs": tuple(absolute(path, folder) for path in self.package_dirs)
        }
        if self.urdf is not None:
            changes["urdf"] = absolute(self.urdf, folder)
        return self.model_copy(update=changes)


class ToolSpec(_FromUrdf):
    """A tool, from a URDF of its own or made of fingers, fixed to a link of the robot.

    Attributes
    ----------
    robot, urdf, package_dirs
        The tool's model: by name or by file, and where its packages lie; or
    fingers : FingersSpec
        a hand of rigid fingers, whose frame ``corner`` is the tip.
    mount : str
        The link of the robot that carries the tool.
    at : Pose
        The tool's root link in the frame of that link.
    """

    mount: str = Field(description="the link of the robot that carries the tool")
    at: Pose = Pose()
    fingers: FingersSpec | None = None

    def _sources(self) -> dict[str, str]:
        return {**super()._sources(), "fingers": "fingertips"}


class ArmSpec(_FromUrdf):
    """One arm: a serial chain of 1 to 16 joints from its base to its tip.

    Attributes
    ----------
    robot : str
        The name of a known robot, or
    urdf : path
        a URDF file.
    package_dirs : list of paths
        Where ``package://`` addresses are looked for first.
    base : Pose
        The root link in the world.
    tip : str
        The link whose frame is joined to the object: of the tool if there is one.
    tool : ToolSpec, optional
        A tool on the robot.
    posture : list or table 'joint: value', optional
        Positions [rad] or [m] at the start, one number per movable joint from base to tip.
        Joints that are not named are at 0, or at the limit nearest to 0.
    velocity : list or table 'joint: value', optional
        Velocities [rad/s] or [m/s] at the start, 0 where not named.
    lock : table 'joint: value'
        Joints that are held fixed at a position [rad] or [m].
    color : '#rrggbb' or 3 or 4 numbers, optional
        Red, green, blue, opacity from 0 to 1.
    """

    base: Pose = Pose()
    tip: str = Field(description="the link that is joined to the object")
    tool: ToolSpec | None = None
    posture: JointValues | None = None
    velocity: JointValues | None = None
    lock: dict[str, Number] = Field(default_factory=dict)
    color: Color | None = None

    def located(self, folder: Path) -> Self:
        """Return this arm with file paths made absolute, relative ones below ``folder``."""
        located = super().located(folder)
        if self.tool is None:
            return located
        return located.model_copy(update={"tool": self.tool.located(folder)})
