"""Small scenes with unilateral constraints: sliders, falling bodies, their closed forms."""

from __future__ import annotations

from pathlib import Path

SLIDER = """<robot name="slider"><link name="rail"/><link name="cart"><inertial>
<mass value="{mass}"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>
</inertial></link><joint name="slide" type="prismatic"><parent link="rail"/><child link="cart"/>
<axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}" effort="100" velocity="10"/>
<dynamics friction="{friction}"/></joint></robot>
"""


def slider(folder: Path, mass=2.0, axis="1 0 0", lower=-5.0, upper=5.0, friction=0.0) -> str:
    """A cart on a rail, as a URDF file in ``folder``; returns its path."""
    path = folder / f"slider_{mass}_{axis.replace(' ', '')}_{lower}_{upper}_{friction}.urdf"
    numbers = {"mass": mass, "axis": axis, "lower": lower, "upper": upper, "friction": friction}
    path.write_text(SLIDER.format(**numbers))
    return str(path)


def happened(trajectory) -> list[dict]:
    """Events of unilateral constraints.

    Without the notice that a cart cannot follow its joint in all directions.
    """
    return [event for event in trajectory.events if "before" in event]


def cart_with_box(folder: Path, effects: dict, *, velocity=0.0, cart=None, **more) -> dict:
    """A box of 3 kg welded to a cart of 2 kg on a rail along x: 5 kg with one freedom."""
    return {
        "name": "cart with a box",
        "object": {
            "shape": {"box": [0.2, 0.2, 0.2]},
            "mass": 3.0,
            "pose": {"xyz": [0.0, 0.0, 0.3]},
            "twist": [velocity, 0, 0, 0, 0, 0],
        },
        "arms": {
            "cart": {
                "urdf": slider(folder, **(cart or {})),
                "tip": "cart",
                "posture": [0.0],
                "velocity": [velocity],
            }
        },
        "joints": [{"arm": "cart", "kind": "weld"}],
        "effects": effects,
        "run": {"duration": 2.0, "accuracy": 1e-9},
        **more,
    }


def body_and_cart(folder: Path, body: dict, effects: dict, **more) -> dict:
    """A free body under gravity; a cart far above it has a fingertip that touches nothing."""
    tip = {"sphere": {"center": [0, 0, 30.0], "radius": 0.05}}
    return {
        "name": "a body on a floor",
        "gravity": [0, 0, -9.81],
        "object": body,
        "arms": {"cart": {"urdf": slider(folder), "tip": "cart", "posture": [0.0]}},
        "joints": [
            {
                "arm": "cart",
                "kind": "contacts",
                "contacts": [{"arm": tip, "object": {"sphere": {"radius": 0.01}}}],
            }
        ],
        "effects": {"unilateral_contacts": {"start": "as_written"}, **effects},
        "run": {"duration": 1.0, "accuracy": 1e-8},
        **more,
    }


def ball_on_cart(folder: Path, effects: dict, *, height=0.0, twist=(0.0,) * 6, **more) -> dict:
    """A ball of 1 kg, radius 5 cm, above a level plate that a cart moves along x."""
    radius = 0.05
    contact = {
        "arm": {"plane": {"normal": [0, 0, 1]}},
        "object": {"sphere": {"radius": radius}},
        "name": "plate",
    }
    return {
        "name": "ball on a cart",
        "gravity": [0, 0, -9.81],
        "object": {
            "shape": {"sphere": radius},
            "mass": 1.0,
            "pose": {"xyz": [0, 0, height + radius]},
            "twist": list(twist),
        },
        "arms": {"cart": {"urdf": slider(folder), "tip": "cart", "posture": [0.0]}},
        "joints": [{"arm": "cart", "kind": "contacts", "contacts": [contact]}],
        "effects": effects,
        "run": {"duration": 1.0, "accuracy": 1e-9},
        **more,
    }
