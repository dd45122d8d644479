from .colours import COLOUR_OF_ROLE as COLOUR_OF_ROLE
from .ellipsoids import (
    Ellipsoids as Ellipsoids,
    error_ellipsoids as error_ellipsoids,
    visible_factor as visible_factor,
)
from .evaluation_plot import expect_plotter as expect_plotter, write_plot as write_plot
from .features_part import (
    features_figure as features_figure,
    features_record as features_record,
    features_text as features_text,
)
from .html import ExtraTable as ExtraTable, write_report as write_report
from .notebook import NotebookDisplays as NotebookDisplays, expect_extra as expect_extra
from .parameter_table import parameter_errors as parameter_errors
from .space_part import (
    Layer as Layer,
    SpaceFigure as SpaceFigure,
    space_figure as space_figure,
)
from .text import (
    counts_text as counts_text,
    errors_text as errors_text,
    reasons_text as reasons_text,
)
from .text_of_evaluation import evaluation_text as evaluation_text
