r"""Configuration stability by sampling: contacts displaced at random, and the share that closes.

Displacements are uniform in discs about the contacts, in their faces. Of n samples k close. The
probability p of closure then lies, with the confidence that belongs to z standard deviations, in
Wilson's interval, which holds near 0 and 1 too:

.. math::
    \frac{k/n + z^2/2n}{1 + z^2/n} \;\pm\;
    \frac{z}{1 + z^2/n} \sqrt{\frac{(k/n)(1 - k/n)}{n} + \frac{z^2}{4 n^2}} .
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.closure_radii import tangents_of
from multiarm.grasp.contacts import Contacts, HeldByContacts, as_contacts
from multiarm.grasp.many_closures import closed_many
from multiarm.grasp.stability import displacements_of


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
    rng: np.random.Generator | int | None = None,
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
    from scipy.stats import norm

    contacts = as_contacts(contacts)
    if not isinstance(samples, Real) or not float(samples).is_integer() or samples < 1:
        raise GraspError(f"samples is a positive whole number, not {samples!r}")
    samples = int(samples)
    if not isinstance(confidence, Real) or not 0.0 < confidence < 1.0:
        raise GraspError(f"confidence is a number between 0 and 1, not {confidence!r}")
    if contacts.dimension != 3:
        raise GraspError("contacts in the plane: displacements are drawn for contacts in space")
    delta = displacements_of(displacement, contacts)
    generator = np.random.default_rng(rng)
    far = np.sqrt(generator.random((samples, contacts.count))) * delta
    angle = generator.uniform(0.0, 2.0 * np.pi, far.shape)
    along = np.stack([far * np.cos(angle), far * np.sin(angle)], axis=-1)
    points = contacts.points + np.einsum("mja,jax->mjx", along, tangents_of(contacts))
    normals = np.broadcast_to(contacts.normals, points.shape)
    kept = int(np.count_nonzero(closed_many(points, normals).closed))
    z = float(norm.ppf(0.5 + 0.5 * confidence))
    share = kept / samples
    middle = (share + z * z / (2 * samples)) / (1.0 + z * z / samples)
    half = z / (1.0 + z * z / samples)
    half *= float(np.sqrt(share * (1.0 - share) / samples + (z / (2 * samples)) ** 2))
    return DrawnStability(
        share, max(0.0, middle - half), min(1.0, middle + half), kept, samples, confidence
    )
