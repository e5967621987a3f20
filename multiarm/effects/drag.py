r"""Resistance of a medium to objects: forces against their motion, in their own axes.

With :math:`u = R_o^T(v_o - w)` the velocity of the centre of mass relative to the medium, whose own
is ``w``, and component by component along the object's axes,

.. math::
    f_k = -\big(c_k + (q_k + \tfrac12\varrho\, C_k A_k)\,|u|\big)\,u_k, \qquad
    m_k = -d_k\,\omega_k ,

Stokes's law at low, Newton's at high Reynolds numbers.  The force acts at the centre of mass.  Its
power is that on the object, :math:`f\cdot v_o + m\cdot\omega_o`: wind may drive it.

*Derivatives.*  In world axes, with :math:`\bar u = v_o - w`, :math:`A = R_o\,
\mathrm{diag}(c_k + \bar q_k |u|) R_o^T`, :math:`Q = R_o\,\mathrm{diag}(\bar q_k) R_o^T` and
:math:`B = R_o\,\mathrm{diag}(d_k) R_o^T`, so that :math:`f = -A\bar u, m = -B\omega`,

.. math::
    \delta f = -A\,\delta v - Q\bar u\,\frac{\bar u\cdot\delta v}{|u|}
               + \theta\times f + A(\theta\times\bar u), \qquad
    \delta m = -B\,\delta\omega + \theta\times m + B(\theta\times\omega) .
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.contacts.motion import open_body
from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.coordinates import force_columns
from multiarm.dynamics.effect_kernels import APPLIED, EffectKernel, set_power, view_of_effect
from multiarm.effects.building import BuildContext
from multiarm.jit.kernels import cfunc, inlined
from multiarm.jit.structs import Floats1, Ints1, struct_at
from multiarm.jit.vectors import (
    AXES,
    add,
    add_cross,
    add_scaled,
    cross,
    dot,
    norm,
    put,
    rotate,
    rotate_back,
    scale,
    sub,
    vec,
)


class Drag(NamedTuple):
    """Resistance along and about an object's axes, each (3,)."""

    objects: Ints1  # that move through the medium
    linear: Floats1  # c [N s/m]
    quadratic: Floats1  # q + rho C A / 2 [N s^2/m^2]
    angular: Floats1  # d [N m s/rad]
    wind: Floats1  # velocity of the medium, world axes [m/s]


open_drag = view_of_effect(Drag)


@cfunc
def add_drag(address, size, at, _t):
    """Add the wrench of the medium on the objects."""
    struct = struct_at(address, size)
    data, drag, power = open_data(struct), open_drag(struct, at), 0.0
    for o in drag.objects:
        body, f_o, first = open_body(data.bodies.objects[o]), data.forces.f_o, 6 * o
        R, u, w = body.rotation, sub(body.velocity, vec(drag.wind, 0)), body.spin
        push = add_scaled(vec(drag.linear, 0), norm(u), vec(drag.quadratic, 0))
        force = scale(-1.0, along_axes(R, push, u))
        moment = scale(-1.0, along_axes(R, vec(drag.angular, 0), w))
        put(f_o, first, add(vec(f_o, first), force))
        put(f_o, first + 3, add(vec(f_o, first + 3), moment))
        power += dot(force, body.velocity) + dot(moment, w)
    set_power(struct, at, power)
    return 0


@cfunc
def differentiate_drag(address, size, at, _t):
    """Add the derivatives of the wrenches."""
    struct = struct_at(address, size)
    data, drag = open_data(struct), open_drag(struct, at)
    for o in drag.objects:
        differentiate_on_object(drag, o, data)
    return 0


@inlined
def differentiate_on_object(drag, o, data):
    """Add the derivatives of the wrench on an object."""
    slopes, first, twists = data.slopes.force, 6 * o, force_columns(data).twists + 6 * o
    body = open_body(data.bodies.objects[o])
    R, u, w = body.rotation, sub(body.velocity, vec(drag.wind, 0)), body.spin
    c, q, d = vec(drag.linear, 0), vec(drag.quadratic, 0), vec(drag.angular, 0)
    speed = norm(u)
    push = add_scaled(c, speed, q)
    f, m = scale(-1.0, along_axes(R, push, u)), scale(-1.0, along_axes(R, d, w))
    growth = along_axes(R, q, u)  # of the force with the speed
    for axis in range(3):
        e = AXES[axis]
        by_speed = dot(u, e) / speed if speed > 0.0 else 0.0
        by_velocity = add_scaled(along_axes(R, push, e), by_speed, growth)
        by_turn = add_cross(along_axes(R, push, cross(e, u)), e, f)
        moment_by_turn = add_cross(along_axes(R, d, cross(e, w)), e, m)
        by_spin = along_axes(R, d, e)
        for k in range(3):
            slopes[first + k, twists + axis] -= by_velocity[k]
            slopes[first + k, first + 3 + axis] += by_turn[k]
            slopes[first + 3 + k, twists + 3 + axis] -= by_spin[k]
            slopes[first + 3 + k, first + 3 + axis] += moment_by_turn[k]


@inlined
def along_axes(R, weights, a):
    """``R diag(weights) R^T a``."""
    b = rotate_back(R, a)
    return rotate(R, (weights[0] * b[0], weights[1] * b[1], weights[2] * b[2]))


def build(spec, context: BuildContext) -> list[EffectKernel]:
    """The kernel of objects that move through a medium."""
    objects = [o for o, name in enumerate(context.layout.objects) if spec.is_of(name)]
    coefficients = spec.linear, spec.per_axis(), spec.angular, spec.wind
    numbers = (np.array(values, dtype=float) for values in coefficients)
    drag = Drag(np.array(objects, dtype=np.int64), *numbers)
    return [
        EffectKernel("drag", add_drag, APPLIED, drag, local=True, derivative=differentiate_drag)
    ]
