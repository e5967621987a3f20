r"""Configuration stability: the effect of small displacements of the contacts (thesis, 2.3).

**Six independent contacts** (2.3.1). With normals :math:`e_A = [e_1 e_2 e_3]` invertible,
:math:`T_1 = -e_A^{-1} e_B` and :math:`a = a_A T_1 + a_B` the contacts are independent while a is
not singular (2.2). In-face displacements of at most :math:`\delta` change column j of a by at most
:math:`\delta (1 + \sum_i |T_{1,ij}|)`. The nearest singular matrix, columns measured one by one,
is this far away:

.. math::
    r^* = \min_{a' \text{ singular}} \max_j |a'_j - a_j| = 1 / \max_{s \in \{-1, 1\}^3} |a^{-T} s|,
    \qquad \delta_{\max} = r^* / \max_j \bigl(1 + \sum_i |T_{1,ij}|\bigr) .

**The seventh contact** (2.3.2). It closes the grasp when all entries of :math:`W_6^{-1} w_7` are
negative. Multiplied by det a each is a polynomial in the points,

.. math:: M_k = \det(W_6 \text{ with } w_7 \text{ for } w_k) / \det e_A, \qquad M_k / \det a < 0 .

M and det a are affine in every single contact. To first order, displacements up to
:math:`\delta_j` change M by at most :math:`\sum_j |\partial M / \partial p_j| \delta_j`, the
seventh contact included. Where this is not much less than :math:`|M|` the grasp is poor. What may
really be lost, and when, is computed without linearisation by
:func:`multiarm.grasp.stability.closure_radii.closure_radius`, and by sampling by
:func:`multiarm.grasp.stability.configuration_stability.monte_carlo_stability`.

**Sampling.**  Displacements are uniform in discs about the contacts, in their faces. The share that
closes estimates the probability of closure; Wilson's interval, which holds near 0 and 1 too, says
how well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from numbers import Real
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.arguments import generator_of, numbers_of
from multiarm.grasp.closure.balances import tolerance_of
from multiarm.grasp.closure.form_closure import closed_many
from multiarm.grasp.contacts import Contacts, HeldByContacts, contacts_in_space, wrenches_of
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.seventh_contact.contact_region import ContactRegion, region_of
from multiarm.grasp.six_contacts.independent_contacts import blocks_of
from multiarm.grasp.stability.closure_radii import ClosureRadius, closure_radius, tangents_of

# A measure should be at least this multiple of its largest change to first order.
ENOUGH = 2.0
# Usual displacement over the root mean square distance of the contacts.
DISPLACEMENT = 0.01
# A measure does not depend on a contact whose rate is below this part of the largest: rounding.
UNFELT = 1e-10
# Three normals span space well enough to be divided by.
SPANNING = 1e-3


@dataclass(frozen=True, eq=False)
class ConfigurationStability:
    """How well a grasp bears displacements of its contacts in their faces.

    Attributes
    ----------
    contacts : Contacts
    displacement : ndarray, shape (N,)
        The distance by which each contact may be displaced [m].
    six : tuple of int
        The six independent contacts, numbers from 0; the first three have independent normals.
        The first six in their order, if that is possible.
    T1, a : ndarray, shape (3, 3)
        Of the block inverse (2.2); a in [m].
    r_star : float
        Smallest change of the columns of a that makes it singular [m].
    sigma_min : float
        Smallest singular value of a [m]; between r* and sqrt(3) r*.
    delta_max : float
        Displacements below it leave the six contacts independent [m].
    determinant : float
        det a [m^3].
    determinant_gradient : ndarray, shape (N, 3)
        Derivative of det a with respect to each contact, in its face [m^2].
    measures : ndarray, shape (6,), or None
        ``M_k``; closure when all M_k / det a are negative [m^3].  None unless N = 7.
    gradient : ndarray, shape (6, 7, 3), or None
        Derivative of each measure with respect to each contact, in its face [m^2].
    message : str
    """

    contacts: Contacts
    displacement: np.ndarray
    six: tuple[int, ...]
    T1: np.ndarray
    a: np.ndarray
    r_star: float
    sigma_min: float
    delta_max: float
    determinant: float
    determinant_gradient: np.ndarray
    measures: np.ndarray | None
    gradient: np.ndarray | None
    message: str

    @property
    def changes(self) -> np.ndarray:
        """Largest change to first order of det a, then of each measure [m^3]; (1,) or (7,)."""
        rates = self.determinant_gradient[None]
        if self.gradient is not None:
            rates = np.concatenate([rates, self.gradient])
        return np.linalg.norm(rates, axis=2) @ self.displacement

    @property
    def ratios(self) -> np.ndarray:
        """Size of det a, then of each measure, over its change; (1,) or (7,).

        Infinite where nothing changes.
        """
        sizes = np.abs(np.r_[self.determinant, [] if self.measures is None else self.measures])
        changes = self.changes
        moving = changes > 0.0
        return np.where(moving, sizes / np.where(moving, changes, 1.0), np.inf)

    @property
    def closed(self) -> bool | None:
        """Whether the seven contacts close; None unless there are seven."""
        if self.measures is None:
            return None
        return bool(np.all(self.measures * np.sign(self.determinant) < 0.0))

    @property
    def poor(self) -> bool:
        """Whether the grasp is open, or a ratio is less than 2."""
        return self.closed is False or bool(self.ratios.min() < ENOUGH)

    @cached_property
    def own_radii(self) -> np.ndarray | None:
        """How far each contact alone may slide in any direction [m], shape (7,); None unless 7."""
        if self.measures is None or self.gradient is None:
            return None
        sizes = np.abs(np.r_[self.determinant, self.measures])
        rates = np.linalg.norm(
            np.concatenate([self.determinant_gradient[None], self.gradient]), axis=2
        )
        felt = rates > UNFELT * rates.max()  # each contact is missing in one of the seven
        ratios = sizes[:, None] / np.where(felt, rates, 1.0)
        return np.where(felt, ratios, np.inf).min(axis=0) * bool(self.closed)

    @cached_property
    def radius(self) -> ClosureRadius | None:
        """How far all contacts may slide at once, not linearised; None for six contacts."""
        return closure_radius(self.contacts) if self.contacts.count > 6 else None


def configuration_stability(
    contacts: Contacts | HeldByContacts, *, displacement: Any = None
) -> ConfigurationStability:
    """Independence of six contacts and measures of the seventh under displacements.

    Parameters
    ----------
    contacts : Contacts, or a grasp
        Six or more, in space.  With seven, the last one is taken as the seventh unless the first
        six are dependent.  With more, six of them are looked at, and ``radius`` at all.
    displacement : float or array-like, shape (N,), optional
        Largest displacement of each contact in its face [m]; a hundredth of their root mean square
        distance from their mean otherwise.

    Raises
    ------
    GraspError
        Fewer than six contacts, contacts in the plane, no six independent ones among them.
    """
    contacts = contacts_in_space(contacts, 6)
    delta = displacements_of(displacement, contacts)
    six = _independent_six(contacts)
    at = contacts.points - contacts.centre
    T1, a = blocks_of(at[list(six)], contacts.normals[list(six)])
    nearest = 1.0 / max(
        float(np.linalg.norm(np.linalg.solve(a.T, s))) for s in product((-1.0, 1.0), repeat=3)
    )
    seventh = [j for j in range(contacts.count) if j not in six] if contacts.count == 7 else []
    values, rates = _measures(contacts, [*six, *seventh])
    return ConfigurationStability(
        contacts=contacts,
        displacement=delta,
        six=six,
        T1=T1,
        a=a,
        r_star=nearest,
        sigma_min=float(np.linalg.svd(a, compute_uv=False)[-1]),
        delta_max=nearest / float((1.0 + np.abs(T1).sum(axis=0)).max()),
        determinant=float(values[0]),
        determinant_gradient=rates[0],
        measures=values[1:] if seventh else None,
        gradient=rates[1:] if seventh else None,
        message=_message(contacts, six),
    )


def own_regions(grasp: Grasp) -> tuple[ContactRegion | None, ...]:
    """Where each contact alone may be in its face while all others stay, one region for each.

    None where the others are dependent: that contact cannot close the grasp, wherever it is.

    Raises
    ------
    GraspError
        Something else than a grasp, or one of fewer than seven contacts.
    """
    if not isinstance(grasp, Grasp):
        raise GraspError(
            f"regions of single contacts need a Grasp, which knows the faces that its contacts "
            f"are on, not {type(grasp).__name__}; seventh_contact_region takes contacts and a face"
        )
    count = grasp.contacts.count
    if count < 7:
        raise GraspError(f"regions of single contacts need seven contacts, not {count}")
    return tuple(
        region_of(grasp.contacts, j, grasp.body.faces[number])
        for j, number in enumerate(grasp.faces)
    )


def displacements_of(displacement: Any, contacts: Contacts) -> np.ndarray:
    """Largest displacement of each contact [m], shape (N,)."""
    value = DISPLACEMENT * contacts.length if displacement is None else displacement
    needed = (
        f"displacement is one length or one for each of the {contacts.count} contacts, finite and "
        f"at least 0"
    )
    delta = numbers_of(value, needed, (), (contacts.count,))
    if np.any(delta < 0.0):
        raise GraspError(f"{needed}, not {displacement}")
    return np.broadcast_to(delta, (contacts.count,)).copy()


def _measures(contacts: Contacts, chosen: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """det a and all M_k, (1,) or (7,), and their derivatives (1, N, 3) or (7, N, 3).

    Determinants are affine in each contact: a difference over any step is the derivative.
    """
    L, count = contacts.length, len(chosen)
    e = contacts.normals[chosen]
    tangents = tangents_of(contacts)[chosen]
    moves = np.zeros((1 + 2 * count, count, 3))
    for k in range(count):
        moves[1 + 2 * k : 3 + 2 * k, k] = tangents[k]
    points = (contacts.points[chosen] - contacts.centre) / L + moves
    W = np.moveaxis(wrenches_of(points, np.broadcast_to(e, points.shape)), 0, 1)  # (S, 6, 6 or 7)
    sets = [W[..., :6]]
    for k in range(6 if count == 7 else 0):
        order = [6 if j == k else j for j in range(6)]
        sets.append(W[..., order])
    values = np.linalg.det(np.array(sets)) / np.linalg.det(e[:3].T)  # (1 or 7, S)
    slopes = (values[:, 1:] - values[:, :1]).reshape(len(sets), count, 2)
    rates = np.zeros((len(sets), contacts.count, 3))
    rates[:, chosen] = np.einsum("mka,kax->mkx", slopes, tangents)
    return values[:, 0] * L**3, rates * L**2


def _independent_six(contacts: Contacts) -> tuple[int, ...]:
    """The first six independent contacts, three with independent normals in front."""
    W, tolerance, chosen = contacts.scaled_wrenches, tolerance_of(contacts), list[int]()
    for j in range(contacts.count):
        trial = [*chosen, j]
        s = np.linalg.svd(W[:, trial], compute_uv=False)
        if len(trial) <= 6 and s[-1] > tolerance * s[0]:
            chosen = trial
    if len(chosen) < 6:
        raise GraspError(
            f"the contacts have rank {len(chosen)}: no six of them are independent, whatever their "
            f"displacements below the next rounding; is_form_closure says which motion is free"
        )
    # Six independent wrenches have normals that span space; the first three that do.
    threes = [[chosen[k] for k in three] for three in combinations(range(6), 3)]
    spans = [np.linalg.svd(contacts.normals[three], compute_uv=False)[-1] for three in threes]
    first = threes[int(np.argmax(np.minimum(spans, SPANNING)))]
    return (*first, *(j for j in chosen if j not in first))


def _message(contacts: Contacts, six: tuple[int, ...]) -> str:
    names = ", ".join(contacts.names[j] for j in six)
    if contacts.count == 6:
        return f"six contacts, in the order {names}"
    if contacts.count == 7:
        return f"independence of {names}; then the remaining contact against them"
    return f"independence of {names}, out of {contacts.count}; measures are for seven contacts only"


# --- Displacements at random ----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class DrawnStability:
    """How many randomly displaced grasps still close.

    Attributes
    ----------
    fraction : float
        Share of the samples that close.
    low, high : float
        Wilson's confidence interval for the probability of closure.
    kept, samples : int
    confidence : float
        Of the interval.
    """

    fraction: float
    low: float
    high: float
    kept: int
    samples: int
    confidence: float


def monte_carlo_stability(
    contacts: Contacts | HeldByContacts,
    displacement: Any,
    samples: int = 2000,
    rng: np.random.Generator | int | None = 0,
    *,
    confidence: float = 0.95,
) -> DrawnStability:
    """Probability that the grasp closes when contacts are displaced at random in their faces.

    Each displacement is uniform in a disc of radius ``displacement`` [m], one for all contacts or
    one for each, shape (N,).

    Raises
    ------
    GraspError
        Displacements that are negative or not finite, no samples, a confidence not within (0, 1).
    """
    from scipy.stats import binomtest

    contacts = contacts_in_space(contacts)
    if not isinstance(samples, Real) or not float(samples).is_integer() or samples < 1:
        raise GraspError(f"samples is a positive whole number, not {samples!r}")
    samples = int(samples)
    if not isinstance(confidence, Real) or not 0.0 < confidence < 1.0:
        raise GraspError(f"confidence is a number between 0 and 1, not {confidence!r}")
    delta = displacements_of(displacement, contacts)
    generator = generator_of(rng, "rng")
    far = np.sqrt(generator.random((samples, contacts.count))) * delta
    angle = generator.uniform(0.0, 2.0 * np.pi, far.shape)
    along = np.stack([far * np.cos(angle), far * np.sin(angle)], axis=-1)
    points = contacts.points + np.einsum("mja,jax->mjx", along, tangents_of(contacts))
    normals = np.broadcast_to(contacts.normals, points.shape)
    closed = int(np.count_nonzero(closed_many(points, normals).closed))
    interval = binomtest(closed, samples).proportion_ci(confidence, method="wilson")
    return DrawnStability(
        closed / samples, float(interval.low), float(interval.high), closed, samples, confidence
    )
