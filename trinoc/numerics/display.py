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
    """Register the function that loads the drawing module when a value is displayed.

    Parameters
    ----------
    source : callable
        Function without arguments that returns the module.
    """
    _sources[:] = [source]


class Displayable:
    """A value that can be displayed at a prompt and in notebooks."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {_sources[0]().heading(self)}>"

    def _repr_html_(self) -> str:
        """HTML of a table and a small figure, used by notebooks."""
        return _sources[0]().html(self)

    def plot(self, axes: Any = None, **options: Any) -> Any:
        """Draw this value with matplotlib (`pip install 'trinoc[plot]'`).

        Parameters
        ----------
        axes : matplotlib axes, optional
            Axes to draw on; new axes by default.
        **options :
            Options that depend on the class of the value, listed in docs/start.md.

        Returns
        -------
        matplotlib axes
        """
        return _sources[0]().plot(self, axes, **options)

    def show(self, **options: Any) -> Any:
        """Return the interactive 3-D figure of the report. Its attribute `html` is a complete page.

        Parameters
        ----------
        **options :
            Options that depend on the class of the value, listed in docs/start.md.
        """
        return _sources[0]().show(self, **options)

    def to_frame(self) -> Any:
        """Return a pandas table with one row per item (`pip install 'trinoc[notebook]'`)."""
        return _sources[0]().to_frame(self)
