"""3-D segments as Parquet: the columns of the CSV, typed. It needs pyarrow."""

from pathlib import Path

from trinoc.errors import InputError
from trinoc.io.atomic import atomic_write
from trinoc.io.formats.format import Format
from trinoc.io.formats.lines_table import lines_table
from trinoc.match import Matches


def write_parquet(matches: Matches, path: Path, unit_mm: float) -> None:
    """Write the columns of `lines_table`. Raises InputError where pyarrow is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            f"{path} is Parquet, which needs pyarrow: pip install 'trinoc[parquet]', or export CSV."
        ) from error
    table = pyarrow.table(lines_table(matches, unit_mm))
    with atomic_write(path) as file:
        pyarrow.parquet.write_table(table, file)


parquet = Format(
    name="parquet",
    title="Parquet",
    holds=("matches",),
    reads=(),
    place="file",
    endings=(".parquet",),
    unit_mm=1.0,
    unit_is_fixed=False,
    frames="the world of the rig; pixel (0, 0) is the centre of the top-left pixel",
    loses=(),
    write=write_parquet,
)
