"""Where the model of a robot or tool comes from, and what the specs of arms and robots share."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, model_validator
from typing_extensions import Self

from multiarm.scene.faults import invalid
from multiarm.scene.joint_values import JointValues, Posture
from multiarm.scene.mjcf import read_mjcf
from multiarm.scene.robots import find_robot, usual_tips
from multiarm.scene.spec import FilePath, Spec
from multiarm.scene.urdf import RobotOutline, read_urdf
from multiarm.scene.values import Color, Number


class ModelSource(Spec):
    """A model by name (``robot``) or by file (``urdf``)."""

    robot: str | None = None
    """The name of a known model; or"""
    urdf: FilePath | None = None
    """a URDF file, instead of a name."""
    package_dirs: tuple[FilePath, ...] = ()
    """Where ``package://`` addresses are looked for first."""

    @model_validator(mode="after")
    def _exactly_one_source(self) -> Self:
        sources = self._sources()
        written = [name for name in sources if getattr(self, name) is not None]
        if len(written) != 1:
            wanted = " or ".join(f"'{name}' ({what})" for name, what in sources.items())
            got = "neither" if not written else "both" if len(written) == 2 else "all"
            raise invalid(f"needs either {wanted}, got {got}")
        return self

    def _sources(self) -> dict[str, str]:
        """The keys, of which exactly one gives the model, with their values."""
        return {"robot": "a name", "urdf": "a file"}

    def usual_tips(self, outline: RobotOutline) -> tuple[str, ...]:
        """The links usually taken as tips of the model with this outline."""
        return usual_tips(outline, self.robot)

    @property
    def file(self) -> Path | None:
        """The file, where one is given instead of a name."""
        return self.urdf

    def read(self) -> RobotOutline:
        """The outline of the model.

        Raises
        ------
        SceneError
            If there is no robot of this name.
        ModelError
            If its file cannot be read.
        """
        path = find_robot(self.robot).urdf if self.robot is not None else self.urdf
        assert path is not None, "a model has a name or a file"
        return read_urdf(path)

    @property
    def shown_by(self) -> str:
        """The command that shows all links and joints of the model."""
        return f"multiarm robots {self.robot or self.file}"


class RobotModel(ModelSource):
    """What arms and robots have in common: model, start and locked joints."""

    mjcf: FilePath | None = None
    """A MuJoCo file, instead of a name."""
    posture: Posture | None = None
    """Positions [rad] or [m] at the start."""
    velocity: JointValues | None = None
    """Velocities [rad/s] or [m/s] at the start, 0 where not named."""
    lock: dict[str, Number] = Field(default_factory=dict)
    """Joints that are held fixed at a position [rad] or [m]."""
    passive: tuple[str, ...] = ()
    """Joints that move without a drive: no control gives them a torque."""
    color: Color | None = None
    """Red, green, blue, opacity from 0 to 1."""

    def _sources(self) -> dict[str, str]:
        return {**super()._sources(), "mjcf": "a MuJoCo file"}

    @property
    def file(self) -> Path | None:
        """The file, where one is given instead of a name."""
        return self.mjcf or self.urdf

    def read(self) -> RobotOutline:
        """The outline of the model; raises as any model's."""
        return super().read() if self.mjcf is None else read_mjcf(self.mjcf)
