"""Solver-neutral programs and the back ends that solve them, independent of power systems.

State a problem with :class:`ProgramBuilder`, freeze it into a :class:`Program`, and pass it to
:func:`solve`, or to :func:`prepare` to solve a sequence of instances.
"""

from solvers.assembly import Assembly, Evaluator
from solvers.bound import dual_bound
from solvers.builder import ProgramBuilder, Rows
from solvers.errors import (
    ProgramError,
    SolverError,
    SolverOptionError,
    UnknownSolverError,
    UnsupportedProgramError,
)
from solvers.expression import Constraint, Expression, Sum, largest, largest_by, stacked, total
from solvers.matrices import Matrices, MatrixMaker, StandardForm, proves_infeasible, standard_form
from solvers.milp import MixedInteger, MixedSolution, solve_mixed
from solvers.program import Block, Cone, Epigraph, Instance, Output, Placement, Program
from solvers.sharing import Sharing
from solvers.solution import Solution, Start
from solvers.solve import (
    BackEnd,
    Session,
    back_ends,
    broken_back_ends,
    find,
    in_parts,
    installed,
    prepare,
    recall_session,
    rescan,
    session_memory,
    solve,
)
from solvers.status import SolutionStatus, TerminationCondition
from solvers.structure import Kind, Structure, classify, curvature_varies, nonconvex_cost
from solvers.template import Degree, Template

__all__ = [
    "Assembly",
    "BackEnd",
    "Block",
    "Cone",
    "Constraint",
    "Degree",
    "Epigraph",
    "Evaluator",
    "Expression",
    "Instance",
    "Kind",
    "Matrices",
    "MatrixMaker",
    "MixedInteger",
    "MixedSolution",
    "Output",
    "Placement",
    "Program",
    "ProgramBuilder",
    "ProgramError",
    "Rows",
    "Session",
    "Sharing",
    "Solution",
    "SolutionStatus",
    "SolverError",
    "SolverOptionError",
    "StandardForm",
    "Start",
    "Structure",
    "Sum",
    "Template",
    "TerminationCondition",
    "UnknownSolverError",
    "UnsupportedProgramError",
    "back_ends",
    "broken_back_ends",
    "classify",
    "curvature_varies",
    "dual_bound",
    "find",
    "in_parts",
    "installed",
    "largest",
    "largest_by",
    "nonconvex_cost",
    "prepare",
    "proves_infeasible",
    "recall_session",
    "rescan",
    "session_memory",
    "solve",
    "solve_mixed",
    "stacked",
    "standard_form",
    "total",
]
