"""The thresholds, all relative: what counts as zero, and why.

Rows are divided by the square root of their own response (see
:mod:`multiarm.events.complementarity.problem`), after which forces and rates have one unit, the
square root of a power per time (or of an energy), whatever the rows are, from grams to tonnes. The
scale is the largest sum of absolute terms in any rate; every threshold but ``RANK`` is a part of
it.
"""

ROUNDING = 1e-12
"""A residual below this is rounding: some thousand machine epsilons, for sums of forty terms."""

RANK = 1e-10
"""A singular value of the scaled response below this part of the largest is zero.

The response is a square, J M^-1 J', so that this is 1e-5 in the rows: two contacts closer to
dependent than that would share their load by digits that are not there. It stands far above the
rounding of a response, 1e-13 or so."""

MARGIN = 1e-9
"""Forces this near to zero, to a bound or to the cone are taken to be there, rates to be zero.

An event leaves the quantity that caused it at zero within the accuracy to which it was located.
Were it held on to, the same event would fire again at once."""

CONSISTENT = 4e-9
"""A motion is reproduced when the rates agree to this: what a few forces within ``MARGIN`` make."""
