"""The common object: its inertia and bias in world axes, in readable form.

The compiled counterpart is :func:`multiarm.equations.object_terms`; this one is the statement of
the equation that it is tested against.
"""

from __future__ import annotations

import numpy as np

from multiarm.terms import ObjectTerms


def object_terms(
    mass: float,
    inertia: np.ndarray,
    rotation: np.ndarray,
    twist: np.ndarray,
    gravity: np.ndarray,
) -> ObjectTerms:
    r"""Inertia and bias of the object about its centre of mass (thesis, 3.2).

    .. math:: I_o = \begin{bmatrix} m I & 0\\ 0 & R I_b R^T\end{bmatrix},\qquad
       h_o = \begin{bmatrix} -m g \\ \omega\times R I_b R^T\omega\end{bmatrix},\qquad
       I_o \dot v_o + h_o = f

    Parameters
    ----------
    mass : float
        [kg]
    inertia : ndarray, shape (3, 3)
        About the centre of mass, object axes [kg m^2].
    rotation : ndarray, shape (3, 3)
        Object to world.
    twist : ndarray, shape (6,)
        Velocity of the centre of mass and angular velocity, world axes.
    gravity : ndarray, shape (3,)
        [m/s^2], world axes.

    Returns
    -------
    ObjectTerms
        With ``v_o'`` classical: there is no ``m omega x v`` term (the printed (3.2) has one).
    """
    world = rotation @ inertia @ rotation.T
    full = np.zeros((6, 6))
    full[:3, :3] = mass * np.eye(3)
    full[3:, 3:] = world
    omega = twist[3:]
    return ObjectTerms(full, np.concatenate([-mass * gravity, np.cross(omega, world @ omega)]))
