from .solver import (
    AbstractArrowProblem as AbstractArrowProblem,
    ArrowEquations as ArrowEquations,
    Solution as Solution,
    solve as solve,
)
