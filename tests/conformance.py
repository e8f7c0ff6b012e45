"""Small programs whose primal and dual answers are known, for every back end that accepts them.

The docstring of each case derives its answer. Signs are those of :class:`solvers.Solution`: the
Lagrangian is ``f + lam_g' g + lam_x' x - z' s``. No case is degenerate: every optimum and every
multiplier is unique.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from solvers import Kind, Program, ProgramBuilder, SolutionStatus, TerminationCondition, total

__all__ = ["CASES", "Answer", "Case"]

Values = Mapping[str, npt.ArrayLike]
ROOT2 = np.sqrt(2.0)


@dataclass(frozen=True)
class Answer:
    """What a solver must find for one instance of a program.

    Attributes
    ----------
    parameters
        Parameters of the instance; the program's own where none are given.
    values, duals, bound_duals, cone_duals
        By block; the entries in the order of the block's vector.
    """

    objective: float
    values: Values = field(default_factory=dict)
    duals: Values = field(default_factory=dict)
    bound_duals: Values = field(default_factory=dict)
    cone_duals: Values = field(default_factory=dict)
    parameters: Values = field(default_factory=dict)


@dataclass(frozen=True)
class Case:
    """A program, its kind, and either its answers or why it has none.

    Attributes
    ----------
    answers
        One for every instance, to be solved one after the other in one session.
    without
        Why there is no optimum: infeasible or unbounded.
    """

    program: Program
    kind: Kind
    answers: tuple[Answer, ...] = ()
    without: TerminationCondition | None = None

    @property
    def status(self) -> SolutionStatus:
        """What a solution of it holds at best."""
        convex = self.kind < Kind.NONLINEAR
        if self.without is TerminationCondition.UNBOUNDED:
            return SolutionStatus.NONE
        if self.without is TerminationCondition.INFEASIBLE:
            return SolutionStatus.PROVEN_INFEASIBLE if convex else SolutionStatus.LOCALLY_INFEASIBLE
        return SolutionStatus.GLOBALLY_OPTIMAL if convex else SolutionStatus.LOCALLY_OPTIMAL


CASES: dict[str, Callable[[], Case]] = {}


def case(make: Callable[[], Case]) -> Callable[[], Case]:
    """Put a case into the library under its own name."""
    CASES[make.__name__] = make
    return make


# Linear ----------------------------------------------------------------------------------------


@case
def merit_order() -> Case:
    """Two units at 10 and 30 $ serve 100; the cheap one has 60.

    The dear one serves the last 40: f = 600 + 1200. It sets the price, 30 + lam = 0; the cheap
    one earns 20 at its upper bound, 10 - 30 + lam_x = 0.
    """
    build = ProgramBuilder("merit order")
    p = build.variable("p", 2, lower=0.0, upper=[60.0, 100.0])
    build.minimize(np.array([10.0, 30.0]) * p)
    build.constrain("balance", total(p) == 100.0)
    answer = Answer(1800.0, {"p": [60.0, 40.0]}, {"balance": [-30.0]}, {"p": [20.0, 0.0]})
    return Case(build.build(), Kind.LINEAR, (answer,))


@case
def two_inequalities() -> Case:
    """min x + 2y with x + y >= 3, x + 3y >= 5: both hold with equality at (2, 1).

    1 + a + b = 0 and 2 + a + 3b = 0 give a = b = -1/2.
    """
    build = ProgramBuilder("two inequalities")
    x, y = build.variable("x", 1, lower=0.0), build.variable("y", 1, lower=0.0)
    build.minimize(x + 2.0 * y)
    build.constrain("a", x + y >= 3.0)
    build.constrain("b", x + 3.0 * y >= 5.0)
    answer = Answer(4.0, {"x": [2.0], "y": [1.0]}, {"a": [-0.5], "b": [-0.5]}, {"x": [0.0], "y": [0.0]})
    return Case(build.build(), Kind.LINEAR, (answer,))


@case
def two_sided_row() -> Case:
    """min 2y - x with -1 <= x - y <= 2, y >= 0, x free: x = y + 2 leaves y - 2, so y = 0.

    -1 + lam = 0, and 2 - lam + lam_y = 0.
    """
    build = ProgramBuilder("two-sided row")
    x, y = build.variable("x", 1), build.variable("y", 1, lower=0.0)
    build.minimize(2.0 * y - x)
    rows = build.rows("between", 1, lower=-1.0, upper=2.0)
    build.add(x - y, into=rows)
    answer = Answer(-2.0, {"x": [2.0], "y": [0.0]}, {"between": [1.0]}, {"x": [0.0], "y": [-1.0]})
    return Case(build.build(), Kind.LINEAR, (answer,))


@case
def fixed_variable() -> Case:
    """min 3x + y with x fixed at 2 and x + y >= 5: y = 3.

    1 + lam = 0; 3 + lam + lam_x = 0: the multiplier of equal bounds is -2.
    """
    build = ProgramBuilder("fixed variable")
    x, y = build.variable("x", 1, lower=2.0, upper=2.0), build.variable("y", 1, lower=0.0)
    build.minimize(3.0 * x + y)
    build.constrain("enough", x + y >= 5.0)
    answer = Answer(9.0, {"x": [2.0], "y": [3.0]}, {"enough": [-1.0]}, {"x": [-2.0], "y": [0.0]})
    return Case(build.build(), Kind.LINEAR, (answer,))


@case
def infeasible_linear() -> Case:
    """Two numbers of at most 1 cannot make 3."""
    build = ProgramBuilder("infeasible linear")
    x = build.variable("x", 2, lower=0.0, upper=1.0)
    build.minimize(x)
    build.constrain("enough", total(x) >= 3.0)
    return Case(build.build(), Kind.LINEAR, without=TerminationCondition.INFEASIBLE)


@case
def unbounded_linear() -> Case:
    """Along (1, 1) both rows hold and the objective falls for ever."""
    build = ProgramBuilder("unbounded linear")
    x, y = build.variable("x", 1, lower=0.0), build.variable("y", 1, lower=0.0)
    build.minimize(-1.0 * x)
    build.constrain("tied", x - y <= 1.0)
    return Case(build.build(), Kind.LINEAR, without=TerminationCondition.UNBOUNDED)


# Quadratic -------------------------------------------------------------------------------------


@case
def equality() -> Case:
    """min (x² + y²)/2 with x + y = 2: x = y = 1, and x + lam = 0."""
    build = ProgramBuilder("equality")
    x = build.variable("x", 2)
    build.minimize(0.5 * x**2)
    build.constrain("sum", total(x) == 2.0)
    answer = Answer(1.0, {"x": [1.0, 1.0]}, {"sum": [-1.0]}, {"x": [0.0, 0.0]})
    return Case(build.build(), Kind.QUADRATIC, (answer,))


@case
def box() -> Case:
    """The point of [0, 1]³ nearest to (-1, 0.5, 3): lam_x = 2 (t - x)."""
    build = ProgramBuilder("box")
    x = build.variable("x", 3, lower=0.0, upper=1.0)
    build.minimize((x - np.array([-1.0, 0.5, 3.0])) ** 2)
    answer = Answer(5.0, {"x": [0.0, 0.5, 1.0]}, {}, {"x": [-2.0, 0.0, 4.0]})
    return Case(build.build(), Kind.QUADRATIC, (answer,))


@case
def nocedal_wright() -> Case:
    """Example 16.4 of Nocedal and Wright, Numerical Optimization: (1.4, 1.7), first row at 0.8."""
    build = ProgramBuilder("Nocedal and Wright 16.4")
    x, y = build.variable("x", 1, lower=0.0), build.variable("y", 1, lower=0.0)
    build.minimize((x - 1.0) ** 2 + (y - 2.5) ** 2)
    build.constrain("a", x - 2.0 * y >= -2.0)
    build.constrain("b", -1.0 * x - 2.0 * y >= -6.0)
    build.constrain("c", -1.0 * x + 2.0 * y >= -2.0)
    answer = Answer(0.8, {"x": [1.4], "y": [1.7]}, {"a": [-0.8], "b": [0.0], "c": [0.0]})
    return Case(build.build(), Kind.QUADRATIC, (answer,))


@case
def hock_schittkowski_35() -> Case:
    """Problem 35 of Hock and Schittkowski: (4/3, 7/9, 4/9) with f = 1/9.

    The derivative in the third, -4 + 2 x_3 + 2 x_1 + 2 lam = 0, gives lam = 2/9.
    """
    build = ProgramBuilder("Hock and Schittkowski 35")
    a, b, c = (build.variable(name, 1, lower=0.0, start=0.5) for name in "abc")
    build.minimize(9.0 - 8.0 * a - 6.0 * b - 4.0 * c)
    build.minimize(2.0 * a**2 + 2.0 * b**2 + c**2 + 2.0 * a * b + 2.0 * a * c)
    build.constrain("plane", a + b + 2.0 * c <= 3.0)
    answer = Answer(1 / 9, {"a": [4 / 3], "b": [7 / 9], "c": [4 / 9]}, {"plane": [2 / 9]})
    return Case(build.build(), Kind.QUADRATIC, (answer,))


@case
def singular_hessian() -> Case:
    """min (x - y)² + x with x >= 1: y follows x without cost, and 1 + lam_x = 0."""
    build = ProgramBuilder("singular Hessian")
    x, y = build.variable("x", 1, lower=1.0), build.variable("y", 1)
    build.minimize((x - y) ** 2 + x)
    answer = Answer(1.0, {"x": [1.0], "y": [1.0]}, {}, {"x": [-1.0], "y": [0.0]})
    return Case(build.build(), Kind.QUADRATIC, (answer,))


@case
def convex_in_pieces() -> Case:
    """min x² + y² and, stated apart, xy - 3x: convex together though xy alone is not.

    2x + y = 3 and 2y + x = 0 give (2, -1) and f = -3.
    """
    build = ProgramBuilder("convex in pieces")
    x, y = build.variable("x", 1), build.variable("y", 1)
    build.minimize(x**2 + y**2)
    build.minimize(x * y - 3.0 * x)
    build.constrain("loose", x - y <= 10.0)
    answer = Answer(-3.0, {"x": [2.0], "y": [-1.0]}, {"loose": [0.0]})
    return Case(build.build(), Kind.QUADRATIC, (answer,))


@case
def parameter_in_a_vector() -> Case:
    """min (x - d)² with x >= 0 and x <= 2d + 10, for three d: x = max(d, 0), lam_x = 2d where d < 0."""
    build = ProgramBuilder("parameter in a vector")
    x, d = build.variable("x", 1, lower=0.0), build.parameter("d", 1, value=1.0)
    build.minimize((x - d) ** 2)
    build.constrain("room", x - 2.0 * d <= 10.0)
    answers = tuple(
        Answer((x - d) ** 2, {"x": [x]}, {"room": [0.0]}, {"x": [min(2 * d, 0.0)]}, parameters={"d": d})
        for d, x in ((1.0, 1.0), (5.0, 5.0), (-3.0, 0.0))
    )
    return Case(build.build(), Kind.QUADRATIC, answers)


@case
def parameter_in_a_coefficient() -> Case:
    """min x² with ax >= 6: x = 6/a, and 2x + a lam = 0."""
    build = ProgramBuilder("parameter in a coefficient")
    x, a = build.variable("x", 1), build.parameter("a", 1, value=2.0)
    build.minimize(x**2)
    build.constrain("enough", a * x >= 6.0)
    answers = tuple(
        Answer(36 / a**2, {"x": [6 / a]}, {"enough": [-12 / a**2]}, parameters={"a": a}) for a in (2.0, 3.0)
    )
    return Case(build.build(), Kind.QUADRATIC, answers)


@case
def parameter_in_the_hessian() -> Case:
    """min c x²/2 - 6x with x <= 10: x = 6/c and f = -18/c."""
    build = ProgramBuilder("parameter in the Hessian")
    x, c = build.variable("x", 1, upper=10.0), build.parameter("c", 1, value=2.0)
    build.minimize(0.5 * c * x**2 - 6.0 * x)
    answers = tuple(
        Answer(-18 / c, {"x": [6 / c]}, {}, {"x": [0.0]}, parameters={"c": c}) for c in (2.0, 3.0)
    )
    return Case(build.build(), Kind.QUADRATIC, answers)


@case
def storage() -> Case:
    """From empty to 3 in three stages at a cost of u²/2: u = 1 throughout.

    u - lam = 0 in every stage; -lam_1 + lam_x = 0 at the fixed start, lam_3 + lam_x = 0 at the end.
    """
    build = ProgramBuilder("storage")
    e = build.variable("e", 1, 4, lower=[[0.0, 0.0, 0.0, 3.0]], upper=[[0.0, 5.0, 5.0, 3.0]])
    u = build.variable("u", 1, 3)
    build.minimize(0.5 * u**2)
    build.constrain("dynamics", e[:, 1:] - e[:, :-1] - u == 0.0)
    answer = Answer(
        1.5,
        {"u": [1.0] * 3, "e": [0.0, 1.0, 2.0, 3.0]},
        {"dynamics": [1.0] * 3},
        {"e": [1.0, 0.0, 0.0, -1.0]},
    )
    return Case(build.build(), Kind.QUADRATIC, (answer,))


@case
def infeasible_quadratic() -> Case:
    """Two numbers of at most 1 cannot make 3, whatever it costs."""
    build = ProgramBuilder("infeasible quadratic")
    x = build.variable("x", 2, lower=0.0, upper=1.0)
    build.minimize(x**2)
    build.constrain("sum", total(x) == 3.0)
    return Case(build.build(), Kind.QUADRATIC, without=TerminationCondition.INFEASIBLE)


@case
def unbounded_quadratic() -> Case:
    """Nothing holds y back, which has no curvature."""
    build = ProgramBuilder("unbounded quadratic")
    x, y = build.variable("x", 1), build.variable("y", 1, lower=0.0)
    build.minimize(x**2 - y)
    build.constrain("loose", x - y <= 1.0)
    return Case(build.build(), Kind.QUADRATIC, without=TerminationCondition.UNBOUNDED)


# Conic -----------------------------------------------------------------------------------------


@case
def norm() -> Case:
    """min t with ||(x - 3, y - 4)|| <= t at x = y = 0: 5.

    z is 1 in t (1 - z_t = 0) and orthogonal to s = (5, -3, -4): z = (1, 0.6, 0.8); lam = z_u.
    """
    build = ProgramBuilder("norm")
    x, t = build.variable("x", 2), build.variable("t", 1)
    build.minimize(t)
    build.cone("norm", t, x[:1] - 3.0, x[1:] - 4.0)
    build.constrain("fixed", x == 0.0)
    answer = Answer(5.0, {"t": [5.0]}, {"fixed": [0.6, 0.8]}, {}, {"norm": [1.0, 0.6, 0.8]})
    return Case(build.build(), Kind.CONIC, (answer,))


@case
def disc() -> Case:
    """min x + y on the unit disc: -sqrt(2); 1 - z_u = 0, and z_t = ||z_u||."""
    build = ProgramBuilder("disc")
    x, y = build.variable("x", 1), build.variable("y", 1)
    build.minimize(x + y)
    build.cone("disc", 1.0, x, y)
    at = -1 / ROOT2
    answer = Answer(-ROOT2, {"x": [at], "y": [at]}, {}, {}, {"disc": [ROOT2, 1.0, 1.0]})
    return Case(build.build(), Kind.CONIC, (answer,))


@case
def nearest_in_a_disc() -> Case:
    """min (x - 2)² + (y - 2)² on the unit disc: both 1/sqrt(2); z_u = 2 (x - 2)."""
    build = ProgramBuilder("nearest in a disc")
    x = build.variable("x", 2)
    build.minimize((x - 2.0) ** 2)
    build.cone("disc", 1.0, x[:1], x[1:])
    at = 1 / ROOT2
    z = 2 * (at - 2)
    answer = Answer(2 * (at - 2) ** 2, {"x": [at, at]}, {}, {}, {"disc": [-z * ROOT2, z, z]})
    return Case(build.build(), Kind.CONIC, (answer,))


@case
def parameter_in_a_cone() -> Case:
    """The largest x with ||(x, y)|| <= r and y given, for (r, y) = (1, 0.6) and (5, 3).

    x = sqrt(r² - y²); -1 - z_x = 0 and z is along (r, -x, -y); lam = z_y.
    """
    build = ProgramBuilder("parameter in a cone")
    x, y = build.variable("x", 1), build.variable("y", 1)
    r, q = build.parameter("r", 1, value=1.0), build.parameter("q", 1, value=0.6)
    build.minimize(-1.0 * x)
    build.constrain("given", y - q == 0.0)
    build.cone("rating", r, x, y)
    answers = tuple(
        Answer(-x, {"x": [x]}, {"given": [-q / x]}, {}, {"rating": [r / x, -1.0, -q / x]}, {"r": r, "q": q})
        for r, q, x in ((1.0, 0.6, 0.8), (5.0, 3.0, 4.0))
    )
    return Case(build.build(), Kind.CONIC, answers)


@case
def cones_by_item_and_stage() -> Case:
    """The largest x in discs of six radii: x = r, y = 0, z = (1, -1, 0) everywhere."""
    radii = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    build = ProgramBuilder("cones by item and stage")
    x, y = build.variable("x", 2, 3), build.variable("y", 2, 3)
    build.minimize(-1.0 * x)
    build.cone("disc", radii, x, y)
    answer = Answer(
        -21.0, {"x": radii.ravel(order="F"), "y": np.zeros(6)}, {}, {}, {"disc": np.tile([1.0, -1.0, 0.0], 6)}
    )
    return Case(build.build(), Kind.CONIC, (answer,))


@case
def infeasible_conic() -> Case:
    """x + y is at most sqrt(2) on the unit disc."""
    build = ProgramBuilder("infeasible conic")
    x, y = build.variable("x", 1), build.variable("y", 1)
    build.minimize(x)
    build.cone("disc", 1.0, x, y)
    build.constrain("far", x + y >= 2.0)
    return Case(build.build(), Kind.CONIC, without=TerminationCondition.INFEASIBLE)


@case
def unbounded_conic() -> Case:
    """A cone is open upwards."""
    build = ProgramBuilder("unbounded conic")
    x, t = build.variable("x", 1), build.variable("t", 1)
    build.minimize(-1.0 * t)
    build.cone("cone", t, x)
    return Case(build.build(), Kind.CONIC, without=TerminationCondition.UNBOUNDED)


# Nonlinear -------------------------------------------------------------------------------------


@case
def hock_schittkowski_71() -> Case:
    """Problem 71 of Hock and Schittkowski, with the multipliers of IPOPT's own documentation."""
    build = ProgramBuilder("Hock and Schittkowski 71")
    a, b, c, d = (
        build.variable(name, 1, lower=1.0, upper=5.0, start=start)
        for name, start in zip("abcd", (1.0, 5.0, 5.0, 1.0), strict=True)
    )
    build.minimize(a * d * (a + b + c) + c)
    build.constrain("product", a * b * c * d >= 25.0)
    build.constrain("sphere", a**2 + b**2 + c**2 + d**2 == 40.0)
    answer = Answer(
        17.0140173,
        {"a": [1.0], "b": [4.7429994], "c": [3.8211503], "d": [1.3794082]},
        {"product": [-0.5522937], "sphere": [0.1614686]},
        {"a": [-1.0878712], "b": [0.0]},
    )
    return Case(build.build(), Kind.NONLINEAR, (answer,))


@case
def hock_schittkowski_7() -> Case:
    """Problem 7 of Hock and Schittkowski: (0, sqrt(3)); -1 + 2 sqrt(3) lam = 0."""
    build = ProgramBuilder("Hock and Schittkowski 7")
    x, y = build.variable("x", 1, start=2.0), build.variable("y", 1, start=2.0)
    build.minimize(np.log(1.0 + x**2) - y)
    build.constrain("curve", (1.0 + x**2) ** 2 + y**2 == 4.0)
    root = np.sqrt(3.0)
    return Case(
        build.build(), Kind.NONLINEAR, (Answer(-root, {"x": [0.0], "y": [root]}, {"curve": [0.5 / root]}),)
    )


@case
def nonconvex_quadratic() -> Case:
    """-x² on [-1, 2] has its minimum at 2, where -4 + lam_x = 0, and another one at -1."""
    build = ProgramBuilder("nonconvex quadratic")
    x = build.variable("x", 1, lower=-1.0, upper=2.0, start=1.0)
    build.minimize(-1.0 * x**2)
    return Case(build.build(), Kind.NONLINEAR, (Answer(-4.0, {"x": [2.0]}, {}, {"x": [4.0]}),))


@case
def infeasible_nonlinear() -> Case:
    """The exponential is at least 1 on the positive numbers; a local method proves nothing."""
    build = ProgramBuilder("infeasible nonlinear")
    x = build.variable("x", 1, lower=0.0, start=1.0)
    build.minimize(x)
    build.constrain("curve", np.exp(x) <= 0.5)
    return Case(build.build(), Kind.NONLINEAR, without=TerminationCondition.INFEASIBLE)
