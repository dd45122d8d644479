from .solver import (
    AbstractArrowProblem as AbstractArrowProblem,
    AbstractSeparableProblem as AbstractSeparableProblem,
    ArrowEquations as ArrowEquations,
    Costs as Costs,
    Solution as Solution,
    solve as solve,
)
