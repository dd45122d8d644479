"""How values show themselves, without knowing who draws them.

Drawing stands on a floor above the values. The package's front door says who draws
(`set_displays`), and a value calls it when it is first shown.
"""

from collections.abc import Callable
from typing import Any

# What gives the one who draws values. It has the functions `heading`, `html`, `plot`,
# `show` and `to_frame`, which take the value first.
_sources: list[Callable[[], Any]] = []


def set_displays(source: Callable[[], Any]) -> None:
    """Let values be shown by what `source` returns; it is called when a value is shown."""
    _sources[:] = [source]


class Displayable:
    """A value that shows itself, at a prompt and in notebooks."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {_sources[0]().heading(self)}>"

    def _repr_html_(self) -> str:
        """A table and a small picture, for notebooks."""
        return _sources[0]().html(self)

    def plot(self, axes: Any = None, **options: Any) -> Any:
        """Draw this on matplotlib axes (`pip install 'trinoc[plot]'`), new ones where none are
        given, and return them. docs/start.md has the options of each kind of value."""
        return _sources[0]().plot(self, axes, **options)

    def show(self, **options: Any) -> Any:
        """The report's figure to turn, of a value in space; its `html` is a page of its own."""
        return _sources[0]().show(self, **options)

    def to_frame(self) -> Any:
        """This as a table of pandas (`pip install 'trinoc[notebook]'`), a row for each item."""
        return _sources[0]().to_frame(self)
