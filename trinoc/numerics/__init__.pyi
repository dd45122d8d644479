from .arrays import (
    ArrayLike as ArrayLike,
    FloatOrTraced as FloatOrTraced,
    NumpyOrTraced as NumpyOrTraced,
    ScalarLike as ScalarLike,
)
from .block_arrow import (
    BlockArrow as BlockArrow,
    BlockArrowSolver as BlockArrowSolver,
    eliminate as eliminate,
)
from .buckets import (
    as_columns as as_columns,
    blocks as blocks,
    bucket as bucket,
    in_blocks as in_blocks,
    in_bucket as in_bucket,
    padded as padded,
    select_in_blocks as select_in_blocks,
    split_columns as split_columns,
)
from .compiler_options import quick_compiling as quick_compiling
from .display import Displayable as Displayable, display_with as display_with
from .information import (
    LARGEST_SIGMA as LARGEST_SIGMA,
    Observability as Observability,
    observability as observability,
    observability_of_root as observability_of_root,
)
from .joins import (
    blocks_of_overlapping as blocks_of_overlapping,
    broadcast_groups as broadcast_groups,
    distinct as distinct,
    expand_ranges as expand_ranges,
    group_labels as group_labels,
    group_medians as group_medians,
    group_sums as group_sums,
    largest as largest,
    members as members,
    near_pairs as near_pairs,
    overlapping as overlapping,
    pairs_of_equal_keys as pairs_of_equal_keys,
    point_tree as point_tree,
    take_groups as take_groups,
)
from .precision import (
    as_float as as_float,
    as_numpy as as_numpy,
    in_float64 as in_float64,
    is_traced as is_traced,
    namespace_of as namespace_of,
)
from .programs import (
    ProgramStore as ProgramStore,
    at_once as at_once,
    keep_programs_in as keep_programs_in,
    kept_jit as kept_jit,
    one_compiles as one_compiles,
)
from .robust_loss import (
    AbstractRobustLoss as AbstractRobustLoss,
    Cauchy as Cauchy,
    GemanMcClure as GemanMcClure,
    ScaleMixture as ScaleMixture,
)
from .small_least_squares import (
    NormalEquations as NormalEquations,
    Residuals as Residuals,
    gauss_newton as gauss_newton,
    misfit_factor as misfit_factor,
    normal_equations as normal_equations,
    whitening as whitening,
)
from .small_matrices import (
    inverse_3x3 as inverse_3x3,
    inverse_positive_definite as inverse_positive_definite,
    log_determinant_positive_definite as log_determinant_positive_definite,
    solve_positive_definite as solve_positive_definite,
)
from .table_checks import (
    CHI_SQUARE as CHI_SQUARE,
    COVARIANCE as COVARIANCE,
    FINITE as FINITE,
    IN_PICTURE as IN_PICTURE,
    IN_SCENE as IN_SCENE,
    LARGEST_MM as LARGEST_MM,
    LARGEST_PX as LARGEST_PX,
    NOT_INFINITE as NOT_INFINITE,
    NOT_NEGATIVE as NOT_NEGATIVE,
    PICTURE_SIZE as PICTURE_SIZE,
    PROBABILITY as PROBABILITY,
    RADIUS as RADIUS,
    SEGMENT_NUMBER as SEGMENT_NUMBER,
    is_covariance as is_covariance,
    number_of as number_of,
)
from .tables import (
    Check as Check,
    Column as Column,
    Content as Content,
    Field as Field,
    Table as Table,
    concatenate_rows as concatenate_rows,
    fields_of as fields_of,
    take_rows as take_rows,
    with_field as with_field,
)
from .tails import (
    MAD_TO_SIGMA as MAD_TO_SIGMA,
    chi_square_limit as chi_square_limit,
    chi_square_quantile as chi_square_quantile,
    chi_square_tail as chi_square_tail,
    log_normal_tail as log_normal_tail,
    log_student_tail as log_student_tail,
    normal_limit as normal_limit,
)
from .vectors import (
    Scalar as Scalar,
    Symmetric3 as Symmetric3,
    Vector2 as Vector2,
    Vector3 as Vector3,
    add3 as add3,
    axes_across as axes_across,
    between as between,
    cross3 as cross3,
    cross_2d as cross_2d,
    cross_3d as cross_3d,
    dot3 as dot3,
    in_front as in_front,
    largest_of as largest_of,
    least_of as least_of,
    nth3 as nth3,
    nth6 as nth6,
    outer3 as outer3,
    scaled3 as scaled3,
    times_matrix as times_matrix,
    total as total,
    unit3 as unit3,
    vector3 as vector3,
)
