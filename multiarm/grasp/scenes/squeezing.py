r"""The squeeze that keeps all fingertips in contact along a path.

The control lets the contacts share a wrench ``w`` with the forces
(:mod:`multiarm.control.force_distribution`)

.. math:: \lambda(w) = W_o^+ w + s\,\lambda_s, \qquad W_o \lambda_s = 0,

where :math:`\lambda_s > 0` has the mean 1.  Weight and inertia of the object along the path give
the wrenches; the smallest squeeze ``s`` with which every force is at least ``f`` is

.. math:: s = \max_{j, w} \frac{f - (W_o^+ w)_j}{(\lambda_s)_j} .
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from multiarm.contacts.internal_forces import distribute, internal_forces
from multiarm.control.object_control import packed_path, reference_motion
from multiarm.grasp.contacts import Contacts
from multiarm.scene import Waypoint
from multiarm.spatial import quaternion_to_matrix

# Places of a way from rest to rest at which its wrenches are looked at.
SAMPLES = np.linspace(0.0, 1.0, 13)


def motion_wrenches(
    path: list[Waypoint], mass: float, inertia: np.ndarray, gravity: np.ndarray
) -> np.ndarray:
    r"""Wrenches that carry the object along a path, shape (K, 6): force [N], moment [N m].

    Newton and Euler, :math:`[m(a - g);\ I\dot\omega + \omega \times I\omega]` about the centre of
    mass in object axes, along the reference of the control laws, from rest to rest at every pose.

    Parameters
    ----------
    path : list of Waypoint
        The first is the start.
    inertia : ndarray, shape (3, 3)
        About the centre of mass, object axes [kg m^2].
    gravity : ndarray, shape (3,)
        World axes [m/s^2].
    """
    parameters = packed_path([w.time for w in path], [w.matrix() for w in path])
    found = []
    for begin, end in pairwise(path):
        for x in SAMPLES:
            t = begin.time + x * (end.time - begin.time)
            quaternion, twist, change = reference_motion(t, parameters, 0)
            R = quaternion_to_matrix(quaternion)
            omega, alpha = R.T @ twist[3:], R.T @ change[3:]
            force = mass * R.T @ (change[:3] - gravity)
            moment = inertia @ alpha + np.cross(omega, inertia @ omega)
            found.append(np.concatenate([force, moment]))
    return np.array(found)


def needed_squeeze(contacts: Contacts, wrenches: np.ndarray, least: float) -> float:
    """Mean internal force [N] with which no contact presses with less than ``least`` [N].

    Parameters
    ----------
    contacts : Contacts
        In form closure; their frame's origin is the centre of mass.
    wrenches : ndarray, shape (K, 6)
        The wrenches that the contacts are to exert.

    Raises
    ------
    GraspError
        When the contacts are not in form closure.
    """
    pressing = internal_forces(contacts.wrenches, "nonnegative", names=contacts.names).basis[:, 0]
    pressing = pressing / np.mean(pressing)
    shares = np.array([distribute(contacts.wrenches, wrench) for wrench in wrenches])
    return float(np.max((least - shares) / pressing, initial=0.0))
