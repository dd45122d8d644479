"""Displays of a value in a notebook, by its kind."""

from html import escape
from typing import Any

from trinoc.errors import expect_extra
from trinoc.numerics.precision import is_traced
from trinoc.report.notebook.axes import plot_value
from trinoc.report.notebook.cards import heading, make_card
from trinoc.report.notebook.space import figure_in_space
from trinoc.report.notebook.tables import list_columns

# Height of the interactive figure with its switches.
_HEIGHT_PX = 760


class NotebookDisplays:
    """The displays that `trinoc.numerics.Displayable` calls."""

    def heading(self, value: Any) -> str:
        """A line of text; within `jit`, `grad` or `vmap` the numbers are unknown."""
        return "traced" if is_traced(value) else heading(value)

    def html(self, value: Any) -> str:
        """A table and a small picture, as HTML."""
        return make_card(value)

    def plot(self, value: Any, axes: Any, **options: Any) -> Any:
        """On axes of matplotlib, which are returned."""
        return plot_value(value, axes, **options)

    def show(self, value: Any, **options: Any) -> "SpacePage":
        """The report's interactive figure."""
        # A prompt that prints a value does not wait for templates.
        from trinoc.report.html import render_space

        figure = figure_in_space(value, **options)
        return SpacePage(render_space(figure, title=f"{type(value).__name__}: {heading(value)}"))

    def to_frame(self, value: Any) -> Any:
        """A table of pandas."""
        return make_frame(value)


class SpacePage:
    """The report's interactive figure as a page of its own: `html`, which a notebook shows."""

    def __init__(self, html: str) -> None:
        self.html = html

    def _repr_html_(self) -> str:
        style = f"width:100%;height:{_HEIGHT_PX}px;border:0"
        return f'<iframe style="{style}" srcdoc="{escape(self.html)}"></iframe>'


def make_frame(value: object) -> Any:
    """A DataFrame, a row for each item. Raises InputError where pandas is missing."""
    expect_extra("pandas", "notebook")
    import pandas

    return pandas.DataFrame(list_columns(value))
