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
    blocks as blocks,
    bucket as bucket,
    finer_bucket as finer_bucket,
    in_blocks as in_blocks,
    in_bucket as in_bucket,
    padded as padded,
)
from .chi_square import (
    chi_square_limit as chi_square_limit,
    chi_square_quantile as chi_square_quantile,
    chi_square_tail as chi_square_tail,
    normal_limit as normal_limit,
)
from .columns import (
    as_columns as as_columns,
    judged_in_blocks as judged_in_blocks,
    split_columns as split_columns,
)
from .compilation import at_once as at_once, one_compiles as one_compiles
from .compiler_options import quick_compiling as quick_compiling
from .display import Displays as Displays, Shown as Shown, display_with as display_with
from .grey import GreyImage as GreyImage, grey_image as grey_image
from .grouped import (
    group_medians as group_medians,
    group_sums as group_sums,
    of_group as of_group,
    taken as taken,
)
from .information import (
    LARGEST_SIGMA as LARGEST_SIGMA,
    Observability as Observability,
    observability as observability,
    observability_of_root as observability_of_root,
)
from .interval_join import (
    blocks_of_overlapping as blocks_of_overlapping,
    expand_ranges as expand_ranges,
    overlapping as overlapping,
    pairs_of_equal_keys as pairs_of_equal_keys,
)
from .kept_programs import (
    ProgramStore as ProgramStore,
    keep_programs_in as keep_programs_in,
    kept_jit as kept_jit,
)
from .log_tails import (
    log_normal_tail as log_normal_tail,
    log_student_tail as log_student_tail,
)
from .manifold_minimiser import (
    AbstractManifoldMinimiser as AbstractManifoldMinimiser,
    DampedDescent as DampedDescent,
)
from .neighbours_in_plane import (
    distinct as distinct,
    group_labels as group_labels,
    near_pairs as near_pairs,
    point_tree as point_tree,
)
from .noise import noise_sigma as noise_sigma
from .options import with_field as with_field
from .precision import (
    as_float as as_float,
    as_numpy as as_numpy,
    in_float64 as in_float64,
    is_traced as is_traced,
    namespace_of as namespace_of,
)
from .response import level_of_light as level_of_light, light_of_level as light_of_level
from .robust_loss import AbstractRobustLoss as AbstractRobustLoss, GemanMcClure as GemanMcClure
from .robust_scale import MAD_TO_SIGMA as MAD_TO_SIGMA
from .scalar_vectors import (
    Scalar as Scalar,
    Symmetric3 as Symmetric3,
    Vector2 as Vector2,
    Vector3 as Vector3,
    add3 as add3,
    between as between,
    cross3 as cross3,
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
from .segmented_arrays import largest as largest, members as members, sums as sums
from .small_matrices import (
    inverse_3x3 as inverse_3x3,
    inverse_positive_definite as inverse_positive_definite,
    log_determinant_positive_definite as log_determinant_positive_definite,
    solve_positive_definite as solve_positive_definite,
)
from .tables import concatenate_rows as concatenate_rows, take_rows as take_rows
from .vector_arrays import axes_across as axes_across, cross_2d as cross_2d, cross_3d as cross_3d
