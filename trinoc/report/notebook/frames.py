"""Values as tables of pandas."""

from typing import Any

from trinoc.report.notebook.extras import expect_extra
from trinoc.report.notebook.tables import columns_of


def frame_of(value: object) -> Any:
    """A DataFrame, a row for each item. Raises InputError where pandas is missing."""
    expect_extra("pandas", "notebook")
    import pandas

    return pandas.DataFrame(columns_of(value))
