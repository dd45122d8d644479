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
    """Implementation of the display methods of `trinoc.numerics.Displayable` for all values.

    The methods return the line of text, the HTML, the drawings and the table of a value, such as a
    rig or matches, for a prompt or a notebook.
    """

    def heading(self, value: Any) -> str:
        """Return a line of text about a value; inside `jit`, `grad` or `vmap`, its numbers are
        omitted.
        """
        return "traced" if is_traced(value) else heading(value)

    def html(self, value: Any) -> str:
        """Return HTML with a table and a small drawing of a value."""
        return make_card(value)

    def plot(self, value: Any, axes: Any, **options: Any) -> Any:
        """Draw a value with matplotlib, and return the axes."""
        return plot_value(value, axes, **options)

    def show(self, value: Any, **options: Any) -> "SpacePage":
        """Return the interactive 3-D figure of a value."""
        # A prompt that prints a value does not wait for templates.
        from trinoc.report.html import render_space

        figure = figure_in_space(value, **options)
        return SpacePage(render_space(figure, title=f"{type(value).__name__}: {heading(value)}"))

    def to_frame(self, value: Any) -> Any:
        """Return a pandas DataFrame of a value."""
        return make_frame(value)


class SpacePage:
    """Interactive 3-D figure as an HTML page. `html` is the page; a notebook displays it."""

    def __init__(self, html: str) -> None:
        self.html = html

    def _repr_html_(self) -> str:
        style = f"width:100%;height:{_HEIGHT_PX}px;border:0"
        return f'<iframe style="{style}" srcdoc="{escape(self.html)}"></iframe>'


def make_frame(value: object) -> Any:
    """Return a DataFrame with a row for each item of a value.

    Raises InputError if pandas is not installed.
    """
    expect_extra("pandas", "notebook")
    import pandas

    return pandas.DataFrame(list_columns(value))
