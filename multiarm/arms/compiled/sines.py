r"""Sine and cosine of many angles in one loop that the compiler turns into vector instructions.

The angle is taken to :math:`|y| \le \pi/4` by subtracting the nearest multiple of
:math:`\pi/2 = P_1 + P_2 + P_3`, whose first two parts have so few digits that their products are
exact (W.J. Cody, W. Waite, Software Manual for the Elementary Functions, 1980).  There the
polynomials of FreeBSD's library (S. Moshier, K.C. Ng; ``k_sin.c``, ``k_cos.c``) are as good as one
unit in the last place, given what ``y`` was rounded by.
"""

from __future__ import annotations

from multiarm.jit.kernels import kernel

# Angles beyond this need more digits of pi [rad].
FAR = 1e5
# Parts of pi/2: 33 digits each, and the rest.
_P1, _P2, _P3 = 1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21
_PER_QUARTER = 6.36619772367581382433e-01  # 2/pi
# Adding and subtracting this rounds to the nearest whole number.
_ROUND = 6755399441055744.0
_S1, _S2, _S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
_S4, _S5, _S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
_C1, _C2, _C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
_C4, _C5, _C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11


@kernel
def write_sines(angle, factor, sine, cosine):
    """Sine and cosine of ``angle * factor``; returns how many are beyond ``FAR`` (or NaN).

    The numbers of those are not to be used.
    """
    far = 0
    for k in range(angle.size):
        x = angle[k] * factor[k]
        far += 0 if abs(x) <= FAR else 1
        quarters = (x * _PER_QUARTER + _ROUND) - _ROUND
        r = x - quarters * _P1
        w = quarters * _P2
        y = r - w
        rest = (r - y) - w - quarters * _P3
        r = y + rest
        rest = (y - r) + rest
        y = r
        z = y * y
        p = _S2 + z * (_S3 + z * (_S4 + z * (_S5 + z * _S6)))
        s = y - ((z * (0.5 * rest - z * y * p) - rest) - z * y * _S1)
        p = z * (_C1 + z * (_C2 + z * (_C3 + z * (_C4 + z * (_C5 + z * _C6)))))
        half = 0.5 * z
        c = 1.0 - half
        c = c + (((1.0 - c) - half) + (z * p - y * rest))
        # quarters modulo four: 0, 1, 2, 3
        turn = quarters - 4.0 * ((0.25 * quarters - 0.375 + _ROUND) - _ROUND)
        odd = (turn == 1.0) | (turn == 3.0)
        a = c if odd else s
        b = s if odd else c
        sine[k] = -a if turn >= 2.0 else a
        cosine[k] = -b if (turn == 1.0) | (turn == 2.0) else b
    return far
