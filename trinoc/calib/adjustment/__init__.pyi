from .agreement import probability_of_agreement as probability_of_agreement
from .circle_points import (
    points_as_adjusted as points_as_adjusted,
    points_before_flat_sheet as points_before_flat_sheet,
)
from .estimate import (
    Adjustment as Adjustment,
    SheetView as SheetView,
    adjusted_views as adjusted_views,
)
from .jackknife import scatter_of_blocks as scatter_of_blocks
from .least_squares import residuals_px as residuals_px
from .model_tests import alternatives as alternatives
from .sheet_shape import (
    HEIGHT_TERMS as HEIGHT_TERMS,
    PRINT_TERMS as PRINT_TERMS,
    point_of_place as point_of_place,
)
from .shifts import apparent_shift as apparent_shift
