r"""Natural motions of a linear system: eigenvalues, shapes, controllability, stability.

A mode moves as :math:`\mathrm{Re}(v\, e^{\lambda t})`, with an eigenvalue :math:`\lambda` of A and
its eigenvector v.  A pair of conjugate eigenvalues :math:`\sigma \pm i\omega` is one mode, with

.. math:: \text{frequency } \frac{\omega}{2\pi}, \qquad
    \text{damping ratio } \frac{-\sigma}{|\lambda|} .

*Controllability* is that of Popov, Belevitch and Hautus: torques reach a mode when
:math:`[A - \lambda I, B]` has full rank.

*Double eigenvalues* with one eigenvector, such as those at zero of motions that nothing drives
back, or of critical damping, are spread by errors :math:`\epsilon |A|` of the matrix by the root of
that.  Eigenvalues, and imaginary parts, below this size count as zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Errors of the derivatives, relative to the largest entry of the system's matrix.
MATRIX_ERROR = 1e-9
# Relative singular value below which a matrix lacks rank.
RANK_TOLERANCE = 1e-8
# Components that are named move at least this part as far as the largest.
NAMED_SHARE, NAMED = 0.3, 3


OSCILLATES, DECAYS, GROWS = "oscillates", "decays", "grows"
OSCILLATES_AND_GROWS = "oscillates and grows"
OSCILLATES_FOR_EVER, DRIFTS = "oscillates for ever", "drifts"
"""Kinds of modes: nothing damps what oscillates for ever, nothing drives back what drifts."""
GROWING = frozenset({GROWS, OSCILLATES_AND_GROWS})
STEADY = frozenset({OSCILLATES_FOR_EVER, DRIFTS})
"""Kinds that neither decay nor grow."""


@dataclass(frozen=True)
class Mode:
    """A natural motion.

    Attributes
    ----------
    eigenvalue : complex
        [1/s]; of a conjugate pair the one above the real axis.
    shape : ndarray of complex, shape (6 F + n,)
        Displacements of objects (shift [m] and rotation vector [rad], world axes) and joints
        [rad, m]; the largest is 1.
    moving : tuple of str
        The components that move most, such as ``object/z``.
    controllable : bool
        Whether torques of the joints reach it.
    kind : str
        ``"oscillates"``, ``"decays"``, ``"grows"``, ``"oscillates and grows"``; ``"oscillates for
        ever"``: nothing damps it; ``"drifts"``: nothing drives it back.
    """

    eigenvalue: complex
    shape: np.ndarray
    moving: tuple[str, ...]
    controllable: bool
    kind: str

    @property
    def frequency(self) -> float:
        """Of the oscillation [Hz]; 0 when there is none."""
        return self.eigenvalue.imag / (2.0 * math.pi)

    @property
    def natural_frequency(self) -> float:
        """Magnitude of the eigenvalue [rad/s]."""
        return abs(self.eigenvalue)

    @property
    def damping_ratio(self) -> float:
        """0 of what is not damped, 1 of what does not oscillate; negative when it grows."""
        if math.isinf(self.time_constant):
            return 0.0
        return -self.eigenvalue.real / abs(self.eigenvalue)

    @property
    def time_constant(self) -> float:
        """Time in which it decays, or grows, by the factor e [s]; infinite when it does neither."""
        return math.inf if self.kind in STEADY else 1.0 / abs(self.eigenvalue.real)


def natural_modes(
    A: np.ndarray, B: np.ndarray, displacements: np.ndarray, names: Sequence[str]
) -> tuple[Mode, ...]:
    """The modes of a system, slowest first.

    Parameters
    ----------
    A, B : ndarray, shapes (s, s), (s, n)
    displacements : ndarray, shape (6 F + n, s)
        Displacements of a state of the linear system.
    names : sequence of str
        Of the displacements.
    """
    eigenvalues, vectors = np.linalg.eig(A)
    size = np.abs(A).max(initial=0.0)
    noise = MATRIX_ERROR * max(size, 1.0)
    modes: list[Mode] = []
    zero = math.sqrt(noise)
    for k in np.lexsort((eigenvalues.real, np.abs(eigenvalues.imag), np.abs(eigenvalues))):
        value = complex(eigenvalues[k])
        drifts = abs(value) < zero
        if abs(value.imag) < zero:
            value = complex(value.real)
        if value.imag < 0.0:
            continue
        shape = displacements @ vectors[:, k]
        largest = int(np.argmax(np.abs(shape)))
        if shape[largest] != 0.0:
            shape = shape / shape[largest]
        share = np.abs(shape)
        order = [int(i) for i in np.argsort(-share, kind="stable") if share[i] > NAMED_SHARE]
        modes.append(
            Mode(
                eigenvalue=value,
                shape=shape,
                moving=tuple(names[i] for i in order[:NAMED]),
                controllable=_is_reached(A, B, value),
                kind=DRIFTS if drifts else _kind(value, noise),
            )
        )
    return tuple(modes)


def stability_of(modes: Sequence[Mode]) -> str:
    """What the linear terms say of the stability of an equilibrium."""
    kinds = {mode.kind for mode in modes}
    if kinds & GROWING:
        return "unstable"
    return "undecided" if kinds & STEADY else "stable"


def _is_reached(A: np.ndarray, B: np.ndarray, eigenvalue: complex) -> bool:
    """Whether inputs reach the motion of an eigenvalue."""
    size = max(np.abs(A).max(), 1.0)
    scale = np.abs(B).max(initial=0.0) or 1.0
    matrix = np.hstack([(A - eigenvalue * np.eye(len(A))) / size, B / scale])
    singular = np.linalg.svd(matrix, compute_uv=False)
    return bool(singular[-1] > RANK_TOLERANCE * singular[0])


def _kind(value: complex, noise: float) -> str:
    if value.imag == 0.0:
        return GROWS if value.real > 0.0 else DECAYS
    if value.real > noise:
        return OSCILLATES_AND_GROWS
    return OSCILLATES if value.real < -noise else OSCILLATES_FOR_EVER
