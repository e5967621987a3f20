"""Integration methods as data: tableaus, error weights and dense output.

A method is a :class:`Tableau`, listed in :data:`METHODS`.  Scene files, the command line and error
messages take the names from there.  Explicit Runge-Kutta methods need no more than a tableau and
the explicit step (:mod:`multiarm.integration.explicit`).  A Rosenbrock method has further
coefficients and a step of its own (:mod:`multiarm.integration.rosenbrock`), and so has the
variational method (:mod:`multiarm.integration.variational`), whose tableau only states its order.

The coefficients are tuples of floats, so that the names are known without importing NumPy.

References
----------
E. Hairer, S.P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., Springer
1993: RK4 (II.1), DOPRI5 (II.5, dense output II.6), DOP853 (II.10).  G. Steinebach, Construction of
Rosenbrock-Wanner method Rodas5P and numerical benchmarks within the Julia Differential Equations
package, BIT Numer. Math. 63:27, 2023.
"""

from __future__ import annotations

import math
from typing import NamedTuple

Vector = tuple[float, ...]
Matrix = tuple[Vector, ...]

# How a step is made, and how the state inside it is interpolated.
EXPLICIT, SEMI_IMPLICIT, ROSENBROCK, VARIATIONAL = range(4)
KINDS = ("explicit Runge-Kutta", "semi-implicit", "Rosenbrock", "variational")
"""Names of these."""
HERMITE, POLYNOMIAL, NESTED, QUARTIC = range(4)


class Tableau(NamedTuple):
    """A one-step method of ``s`` stages, and ``x`` further ones for the dense output only."""

    name: str
    order: int
    A: Matrix  # (s + x, s + x), strictly lower triangular
    b: Vector  # (s,)
    c: Vector  # (s + x,)
    error_order: int = 0  # of the solution that errors are estimated with; 0: fixed-step method
    # (1 or 2, s + 1), weights of the error estimates; the last belongs to the slope at the end of
    # the step.  Two estimates are combined as e5^2 / sqrt(e5^2 + 0.01 e3^2) (Hairer's DOP853).
    error: Matrix = ()
    dense: Matrix = ()  # (k, s + 1 + x), see ``dense_kind``
    # HERMITE (cubic), POLYNOMIAL (rows: coefficients of powers of theta for every slope), NESTED
    # (DOP853's nested form) or QUARTIC (Rodas5P's)
    dense_kind: int = HERMITE
    kind: int = EXPLICIT
    # end of the region of stability on the negative real axis; infinite: not watched
    stability: float = math.inf
    closes_gaps: bool = False  # a step ends on the joints: no projection follows
    # further coefficients of Rosenbrock methods: see :mod:`multiarm.integration.rosenbrock`
    gamma: float = 0.0
    C: Matrix = ()  # (s, s)
    d: Vector = ()  # (s,)
    purpose: str = ""  # when to choose it

    @property
    def adaptive(self) -> bool:
        """Whether the method estimates its errors and so chooses its steps."""
        return self.error_order > 0


def _matrix(rows: int, columns: int, entries: dict[int, dict[int, float]]) -> Matrix:
    """A matrix of which only the entries that are not zero are given, by row and column."""
    return tuple(tuple(entries.get(i, {}).get(j, 0.0) for j in range(columns)) for i in range(rows))


# fmt: off

_DOP853_A = _matrix(16, 16, {
    1: {0: 0.05260015195876773},
    2: {0: 0.0197250569845379, 1: 0.0591751709536137},
    3: {0: 0.02958758547680685, 2: 0.08876275643042054},
    4: {0: 0.2413651341592667, 2: -0.8845494793282861, 3: 0.924834003261792},
    5: {0: 0.037037037037037035, 3: 0.17082860872947386, 4: 0.12546768756682242},
    6: {0: 0.037109375, 3: 0.17025221101954405, 4: 0.06021653898045596, 5: -0.017578125},
    7: {0: 0.03709200011850479, 3: 0.17038392571223998, 4: 0.10726203044637328, 5: -0.015319437748624402, 6: 0.008273789163814023},
    8: {0: 0.6241109587160757, 3: -3.3608926294469414, 4: -0.868219346841726, 5: 27.59209969944671, 6: 20.154067550477894, 7: -43.48988418106996},
    9: {0: 0.47766253643826434, 3: -2.4881146199716677, 4: -0.590290826836843, 5: 21.230051448181193, 6: 15.279233632882423, 7: -33.28821096898486, 8: -0.020331201708508627},
    10: {0: -0.9371424300859873, 3: 5.186372428844064, 4: 1.0914373489967295, 5: -8.149787010746927, 6: -18.52006565999696, 7: 22.739487099350505, 8: 2.4936055526796523, 9: -3.0467644718982196},
    11: {0: 2.273310147516538, 3: -10.53449546673725, 4: -2.0008720582248625, 5: -17.9589318631188, 6: 27.94888452941996, 7: -2.8589982771350235, 8: -8.87285693353063, 9: 12.360567175794303, 10: 0.6433927460157636},
    12: {0: 0.054293734116568765, 5: 4.450312892752409, 6: 1.8915178993145003, 7: -5.801203960010585, 8: 0.3111643669578199, 9: -0.1521609496625161, 10: 0.20136540080403034, 11: 0.04471061572777259},
    13: {0: 0.056167502283047954, 6: 0.25350021021662483, 7: -0.2462390374708025, 8: -0.12419142326381637, 9: 0.15329179827876568, 10: 0.00820105229563469, 11: 0.007567897660545699, 12: -0.008298},
    14: {0: 0.03183464816350214, 5: 0.028300909672366776, 6: 0.053541988307438566, 7: -0.05492374857139099, 10: -0.00010834732869724932, 11: 0.0003825710908356584, 12: -0.00034046500868740456, 13: 0.1413124436746325},
    15: {0: -0.42889630158379194, 5: -4.697621415361164, 6: 7.683421196062599, 7: 4.06898981839711, 8: 0.3567271874552811, 12: -0.0013990241651590145, 13: 2.9475147891527724, 14: -9.15095847217987},
})

_DOP853_C = (0.0, 0.05260015195876773, 0.0789002279381516, 0.1183503419072274, 0.2816496580927726, 0.3333333333333333, 0.25, 0.3076923076923077, 0.6512820512820513, 0.6, 0.8571428571428571, 1.0, 1.0, 0.1, 0.2, 0.7777777777777778)

_DOP853_ERROR = _matrix(2, 13, {
    0: {0: 0.01312004499419488, 5: -1.2251564463762044, 6: -0.4957589496572502, 7: 1.6643771824549864, 8: -0.35032884874997366, 9: 0.3341791187130175, 10: 0.08192320648511571, 11: -0.022355307863886294},
    1: {0: -0.18980075407240762, 5: 4.450312892752409, 6: 1.8915178993145003, 7: -5.801203960010585, 8: -0.4226823213237919, 9: -0.1521609496625161, 10: 0.20136540080403034, 11: 0.02265179219836082},
})

_DOP853_DENSE = _matrix(4, 16, {
    0: {0: -8.428938276109013, 5: 0.5667149535193777, 6: -3.0689499459498917, 7: 2.38466765651207, 8: 2.117034582445028, 9: -0.871391583777973, 10: 2.2404374302607883, 11: 0.6315787787694688, 12: -0.08899033645133331, 13: 18.148505520854727, 14: -9.194632392478356, 15: -4.436036387594894},
    1: {0: 10.427508642579134, 5: 242.28349177525817, 6: 165.20045171727028, 7: -374.5467547226902, 8: -22.113666853125306, 9: 7.733432668472264, 10: -30.674084731089398, 11: -9.332130526430229, 12: 15.697238121770845, 13: -31.139403219565178, 14: -9.35292435884448, 15: 35.81684148639408},
    2: {0: 19.985053242002433, 5: -387.0373087493518, 6: -189.17813819516758, 7: 527.8081592054236, 8: -11.57390253995963, 9: 6.8812326946963, 10: -1.0006050966910838, 11: 0.7777137798053443, 12: -2.778205752353508, 13: -60.19669523126412, 14: 84.32040550667716, 15: 11.99229113618279},
    3: {0: -25.69393346270375, 5: -154.18974869023643, 6: -231.5293791760455, 7: 357.6391179106141, 8: 93.40532418362432, 9: -37.45832313645163, 10: 104.0996495089623, 11: 29.8402934266605, 12: -43.53345659001114, 13: 96.32455395918828, 14: -39.17726167561544, 15: -149.72683625798564},
})

_DOPRI5_A = _matrix(6, 6, {
    1: {0: 1 / 5},
    2: {0: 3 / 40, 1: 9 / 40},
    3: {0: 44 / 45, 1: -56 / 15, 2: 32 / 9},
    4: {0: 19372 / 6561, 1: -25360 / 2187, 2: 64448 / 6561, 3: -212 / 729},
    5: {0: 9017 / 3168, 1: -355 / 33, 2: 46732 / 5247, 3: 49 / 176, 4: -5103 / 18656},
})
_DOPRI5_B = (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84)
_DOPRI5_ERROR = ((-71 / 57600, 0.0, 71 / 16695, -71 / 1920, 17253 / 339200, -22 / 525, 1 / 40),)
# powers 1..4 of theta in the rows, slopes in the columns (Shampine, Math. Comp. 46, 1986)
_DOPRI5_DENSE = (
    (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    (-8048581381 / 2820520608, 0.0, 131558114200 / 32700410799, -1754552775 / 470086768,
     127303824393 / 49829197408, -282668133 / 205662961, 40617522 / 29380423),
    (8663915743 / 2820520608, 0.0, -68118460800 / 10900136933, 14199869525 / 1410260304,
     -318862633887 / 49829197408, 2019193451 / 616988883, -110615467 / 29380423),
    (-12715105075 / 11282082432, 0.0, 87487479700 / 32700410799, -10690763975 / 1880347072,
     701980252875 / 199316789632, -1453857185 / 822651844, 69997945 / 29380423),
)

_RODAS5P_LAST = {0: -7.502846399306121, 1: 2.561846144803919, 2: -11.627539656261098, 3: -0.18268767659942256, 4: 0.030198172008377946}
_RODAS5P_A = _matrix(8, 8, {
    1: {0: 3.0},
    2: {0: 2.849394379747939, 1: 0.45842242204463923},
    3: {0: -6.954028509809101, 1: 2.489845061869568, 2: -10.358996098473584},
    4: {0: 2.8029986275628964, 1: 0.5072464736228206, 2: -0.3988312541770524, 3: -0.04721187230404641},
    5: _RODAS5P_LAST,
    # The last stages refine the end of the step: each begins where the one before ended.
    6: {**_RODAS5P_LAST, 5: 1.0},
    7: {**_RODAS5P_LAST, 5: 1.0, 6: 1.0},
})

_RODAS5P_C = _matrix(8, 8, {
    1: {0: -14.155112264123755},
    2: {0: -17.97296035885952, 1: -2.859693295451294},
    3: {0: 147.12150275711716, 1: -1.41221402718213, 2: 71.68940251302358},
    4: {0: 165.43517024871676, 1: -0.4592823456491126, 2: 42.90938336958603, 3: -5.961986721573306},
    5: {0: 24.854864614690072, 1: -3.0009227002832186, 2: 47.4931110020768, 3: 5.5814197821558125, 4: -0.6610691825249471},
    6: {0: 30.91273214028599, 1: -3.1208243349937974, 2: 77.79954646070892, 3: 34.28646028294783, 4: -19.097331116725623, 5: -28.087943162872662},
    7: {0: 37.80277123390563, 1: -3.2571969029072276, 2: 112.26918849496327, 3: 66.9347231244047, 4: -40.06618937091002, 5: -54.66780262877968, 6: -9.48861652309627},
})
_RODAS5P_DENSE = (
    (25.948786856663858, -2.5579724845846235, 10.433815404888879, -2.3679251022685204, 0.524948541321073, 1.1241088310450404, 0.4272876194431874, -0.17202221070155493),
    (-9.91568850695171, -0.9689944594115154, 3.0438037242978453, -24.495224566215796, 20.176138334709044, 15.98066361424651, -6.789040303419874, -6.710236069923372),
    (11.419903575922262, 2.8879645146136994, 72.92137995996029, 80.12511834622643, -52.072871366152654, -59.78993625266729, -0.15582684282751913, 4.883087185713722),
)
_RODAS5P_NODES = (0.0, 0.6358126895828704, 0.4095798393397535, 0.9769306725060716, 0.4288403609558664, 1.0, 1.0, 1.0)
_RODAS5P_D = (0.21193756319429014, -0.42387512638858027, -0.3384627126235924, 1.8046452872882734, 2.325825639765069, 0.0, 0.0, 0.0)
# fmt: on

SEMI_IMPLICIT_EULER = Tableau(
    "semi_implicit_euler",
    order=1,
    A=((0.0,),),
    b=(1.0,),
    c=(0.0,),
    kind=SEMI_IMPLICIT,
    purpose="to compare with game and robot simulators, which step like this: cheap and coarse",
)
RK4 = Tableau(
    "rk4",
    order=4,
    A=_matrix(4, 4, {1: {0: 0.5}, 2: {1: 0.5}, 3: {2: 1.0}}),
    b=(1 / 6, 2 / 6, 2 / 6, 1 / 6),
    c=(0.0, 0.5, 0.5, 1.0),
    purpose="where every step must have the same length, as with a fixed sampling time",
)
DOPRI5 = Tableau(
    "dopri5",
    order=5,
    A=_DOPRI5_A,
    b=_DOPRI5_B,
    c=(0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0),
    error_order=4,
    error=_DOPRI5_ERROR,
    dense=_DOPRI5_DENSE,
    dense_kind=POLYNOMIAL,
    stability=3.25,
    purpose="for a moderate accuracy, of 1e-3 and coarser; chosen there by default",
)
# Row 12 of Hairer's matrix repeats b: it is the end of the step, where the next one begins.
DOP853 = Tableau(
    "dop853",
    order=8,
    A=_DOP853_A,
    b=_DOP853_A[12][:12],
    c=_DOP853_C,
    error_order=7,
    error=_DOP853_ERROR,
    dense=_DOP853_DENSE,
    dense_kind=NESTED,
    stability=6.1,
    purpose="for a high accuracy, finer than 1e-3; chosen there by default",
)
RODAS5P = Tableau(
    "rodas5p",
    order=5,
    A=_RODAS5P_A,
    b=(*_RODAS5P_A[7][:7], 1.0),
    c=_RODAS5P_NODES,
    error_order=4,
    error=_matrix(1, 9, {0: {7: 1.0}}),
    dense=_RODAS5P_DENSE,
    dense_kind=QUARTIC,
    kind=ROSENBROCK,
    gamma=0.21193756319429014,
    C=_RODAS5P_C,
    d=_RODAS5P_D,
    purpose="for stiff scenes, with hard springs or strong dampers; chosen when a run turns out stiff",
)
VARIATIONAL_MIDPOINT = Tableau(
    "variational",
    order=2,
    A=((0.0,),),
    b=(1.0,),
    c=(0.0,),
    kind=VARIATIONAL,
    closes_gaps=True,
    purpose="for long motions whose energy must not drift; keeps the joints closed itself",
)

METHODS = {
    m.name: m for m in (SEMI_IMPLICIT_EULER, VARIATIONAL_MIDPOINT, RK4, DOPRI5, DOP853, RODAS5P)
}
FIXED_STEP_INTEGRATORS = tuple(name for name, method in METHODS.items() if not method.adaptive)
ADAPTIVE_INTEGRATORS = tuple(name for name, method in METHODS.items() if method.adaptive)
