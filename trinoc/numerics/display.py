"""Display of values at a prompt and in notebooks, independent of the drawing code.

Drawing belongs to a higher floor. The package's front door registers it (`set_displays`), and a
value loads it when it is first displayed.
"""

from collections.abc import Callable
from typing import Any

# Loader of the drawing module. That has the functions `heading`, `html`, `plot`, `show` and
# `to_frame`, whose first argument is the value.
_sources: list[Callable[[], Any]] = []


def set_displays(source: Callable[[], Any]) -> None:
    """Register the loader of the drawing functions; it is called when a value is displayed."""
    _sources[:] = [source]


class Displayable:
    """A value with displays for prompts and notebooks."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {_sources[0]().heading(self)}>"

    def _repr_html_(self) -> str:
        """HTML of a table and a small figure, for notebooks."""
        return _sources[0]().html(self)

    def plot(self, axes: Any = None, **options: Any) -> Any:
        """Draw this value with matplotlib (`pip install 'trinoc[plot]'`).

        Parameters
        ----------
        axes : matplotlib axes, optional
            Axes to draw on; new ones by default.
        **options :
            Options of the kind of value, listed in docs/start.md.

        Returns
        -------
        matplotlib axes
        """
        return _sources[0]().plot(self, axes, **options)

    def show(self, **options: Any) -> Any:
        """Return the interactive 3-D figure of the report; its `html` is a complete page."""
        return _sources[0]().show(self, **options)

    def to_frame(self) -> Any:
        """Return a pandas table with one row per item (`pip install 'trinoc[notebook]'`)."""
        return _sources[0]().to_frame(self)
