"""The ways in which a value shows itself, each by its kind."""

from typing import Any

from trinoc.numerics.precision import is_traced
from trinoc.report.notebook.axes import plot_value
from trinoc.report.notebook.cards import heading, make_card
from trinoc.report.notebook.extras import expect_extra
from trinoc.report.notebook.figures import make_figure
from trinoc.report.notebook.tables import list_columns


class NotebookDisplays:
    """What `trinoc.numerics.Displayable` asks for."""

    def heading(self, value: Any) -> str:
        """A line of text; within `jit`, `grad` or `vmap` there are no numbers to tell."""
        return "traced" if is_traced(value) else heading(value)

    def html(self, value: Any) -> str:
        """A table and a small picture, as HTML."""
        return make_card(value)

    def plot(self, value: Any, axes: Any, **options: Any) -> Any:
        """On axes of matplotlib, which are returned."""
        return plot_value(value, axes, **options)

    def show(self, value: Any, **options: Any) -> Any:
        """A figure of plotly."""
        return make_figure(value, **options)

    def to_frame(self, value: Any) -> Any:
        """A table of pandas."""
        return make_frame(value)


def make_frame(value: object) -> Any:
    """A DataFrame, a row for each item. Raises InputError where pandas is missing."""
    expect_extra("pandas", "notebook")
    import pandas

    return pandas.DataFrame(list_columns(value))
