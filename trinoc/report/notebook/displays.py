"""The four ways in which a value shows itself, each by its kind."""

from typing import Any

from trinoc.report.notebook.axes import plot_value
from trinoc.report.notebook.cards import card
from trinoc.report.notebook.extras import expect_extra
from trinoc.report.notebook.figures import figure_of
from trinoc.report.notebook.tables import columns_of


class NotebookDisplays:
    """What `trinoc.numerics.Displayable` asks for."""

    def html(self, value: Any) -> str:
        """A table and a small picture, as HTML."""
        return card(value)

    def plot(self, value: Any, axes: Any, **options: Any) -> Any:
        """On axes of matplotlib, which are returned."""
        return plot_value(value, axes, **options)

    def show(self, value: Any, **options: Any) -> Any:
        """A figure of plotly."""
        return figure_of(value, **options)

    def to_frame(self, value: Any) -> Any:
        """A table of pandas."""
        return frame_of(value)


def frame_of(value: object) -> Any:
    """A DataFrame, a row for each item. Raises InputError where pandas is missing."""
    expect_extra("pandas", "notebook")
    import pandas

    return pandas.DataFrame(columns_of(value))
