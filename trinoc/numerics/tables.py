"""Tables: values made of columns, each declared once; operations on rows; grouped options.

A table is a frozen Module. The annotation of a field gives kind and shape of the column, as in
jaxtyping: `Float[np.ndarray, "t 2 3"]`. Axes of the same name have the same length in all columns.
`Annotated` adds a `Column`: the checks of the values, and the names of the numbers in a row. The
class's docstring describes each column. File formats, pandas frames, CSV, Parquet and notebook
cards derive from these declarations. Common checks are at the end of the file.
"""

import dataclasses
import functools
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, NamedTuple, TypeVar, overload

import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.numerics.values import Value

_Rows = TypeVar("_Rows")
_Options = TypeVar("_Options")
_TableType = TypeVar("_TableType", bound="Table")

# Kinds of jaxtyping's Float, Int and Bool; Shaped is for texts.
_DTYPES = {"f": "float64", "i": "int64", "b": "bool"}
# Most numbers of a row in a brief table: both ends of a line in space.
_MOST_BRIEF = 6


class Content(NamedTuple):
    """Content of a table file.

    Attributes
    ----------
    values : dict
        Values by the name of the field.
    sides : dict of str to int
        Length of each named axis.
    """

    values: dict[str, Any]
    sides: dict[str, int]


class ColumnCheck(NamedTuple):
    """Test of the values of one field.

    Attributes
    ----------
    problem : str
        Description of the first row that fails, as the end of a sentence.
    good : callable
        Function of the values and the content of the table. It returns a mask over the rows, or one
        bool for the whole field.
    """

    problem: str
    good: Callable[[Any, Content], Any]


class Column:
    """Properties of a field in addition to its kind and shape.

    Parameters
    ----------
    checks : ColumnCheck
        Tests of the values.
    parts : sequence of str, or callable
        Names of the numbers in one row, or a function of the table that returns them. For a
        covariance, the names of its variables.
    side : str
        For a field that is a tuple of names, such as view names: name of the axis whose entries
        these names label.
    per_row : bool
        For a dictionary of arrays: True if each array has one row per row of the table. The keys
        are then names of columns.
    blocks : callable
        For a tuple of square matrices: function of the content that returns the number of rows of
        each matrix.
    prefix : str
        For a table in a table: prefix of its array names in a file.
    """

    def __init__(
        self,
        *checks: ColumnCheck,
        parts: Sequence[str] | Callable[[Any], Sequence[str]] = (),
        side: str = "",
        per_row: bool = False,
        blocks: Callable[[Content], Sequence[int]] | None = None,
        prefix: str = "",
    ) -> None:
        self.checks, self.parts, self.side = checks, parts, side
        self.per_row, self.blocks, self.prefix = per_row, blocks, prefix


class Field(NamedTuple):
    """Declaration of one field of a table.

    Attributes
    ----------
    name : str
        Name of the field.
    type : type
        Its type.
    column : Column
        Its further properties.
    optional : bool
        True if the field may be missing.
    kind : str
        Kind of the numbers in the array: "f", "i", "b", or "U" for text; "" if the field is no
        array.
    sides : tuple of str
        Names of the axes of the array; empty if the field is no array.
    """

    name: str
    type: Any
    column: Column
    optional: bool
    kind: str
    sides: tuple[str, ...]

    @property
    def array_prefix(self) -> str:
        """Prefix of the array names if the field is stored as several arrays."""
        return "" if self.column.per_row else self.column.prefix or f"{self.name}/"


class Table(Value):
    """A value that consists of columns, each declared once.

    Notes
    -----
    Class variables:

    KIND : str
        Name of this kind of table in files.
    IN_WORDS : str
        Name of this kind of table in sentences.
    SIDES : mapping
        Plural noun for the items along each named axis. The first axis counts the rows.
    DERIVED : mapping
        Computed properties with one entry per row, which are not stored in files. Key: name of the
        property. Value: names of the numbers in one entry.
    """

    KIND: ClassVar[str] = ""
    IN_WORDS: ClassVar[str] = ""
    SIDES: ClassVar[Mapping[str, str]] = {}
    DERIVED: ClassVar[Mapping[str, Sequence[str]]] = {}

    def __len__(self) -> int:
        return len(next(iter(self.rows().values())))

    @overload
    def __getitem__(self, rows: int | np.integer) -> "TableRow": ...

    @overload
    def __getitem__(
        self: _TableType, rows: slice | Sequence[int] | Sequence[bool] | np.ndarray
    ) -> _TableType: ...

    def __getitem__(self, rows: Any) -> Any:
        """Return one row, or a table of several rows, as indexing in NumPy does.

        Parameters
        ----------
        rows : int, slice, list of indices or mask
            The rows.

        Raises
        ------
        IndexError
            If a row is missing, or a mask has another length.
        """
        indices = np.arange(len(self))[rows]
        return TableRow(self, int(indices)) if np.ndim(indices) == 0 else self.take(indices)

    def __iter__(self) -> Iterator["TableRow"]:
        return (TableRow(self, index) for index in range(len(self)))

    def rows(self) -> dict[str, Any]:
        """Values of all fields with one entry per row, by name.

        A dictionary of arrays is one field.
        """
        first = next(iter(self.SIDES))
        fields = {
            field.name: (field, getattr(self, field.name)) for field in list_fields(type(self))
        }
        return {
            name: value
            for name, (field, value) in fields.items()
            if value is not None and (field.sides[:1] == (first,) or field.column.per_row)
        }

    def take(self: _TableType, rows: np.ndarray) -> _TableType:
        """Table of the rows at the given indices in their order, or of the rows in a mask."""
        return dataclasses.replace(self, **take_rows(self.rows(), rows))

    def append(self: _TableType, rows: Mapping[str, np.ndarray]) -> _TableType:
        """Table with further rows at the end.

        Parameters
        ----------
        rows : mapping of str to array
            New entries of each column, by name. The entries of a missing column are False, 0 or "".
        """
        count = len(next(iter(rows.values())))

        def longer(name: str, column: Any) -> Any:
            if isinstance(column, dict):
                return {key: longer(key, array) for key, array in column.items()}
            missing = np.zeros((count, *np.shape(column)[1:]), column.dtype)
            return np.concatenate([np.asarray(column), rows.get(name, missing)])

        return dataclasses.replace(
            self, **{name: longer(name, column) for name, column in self.rows().items()}
        )

    def named_columns(self, *, brief: bool = False) -> dict[str, np.ndarray]:
        """Table as scalar columns (n,) by name, one for each number in a row.

        The columns of the properties in `DERIVED` come last.

        Parameters
        ----------
        brief : bool
            True to omit fields with more than six numbers per row, such as covariances and images.
        """
        columns: dict[str, np.ndarray] = {}
        fields = {field.name: field.column for field in list_fields(type(self))}
        for name, value in self.rows().items():
            parts = fields[name].parts
            names = parts(self) if callable(parts) else parts
            for label, array in value.items() if isinstance(value, dict) else [(name, value)]:
                if not brief or np.prod(np.shape(array)[1:]) <= _MOST_BRIEF:
                    columns |= _name_parts(label, np.asarray(array), names)
        for name, parts in self.DERIVED.items():
            columns |= _name_parts(name, np.asarray(getattr(self, name)), parts)
        return columns


class TableRow:
    """One row of a table.

    Its attributes are the entries of the columns and of derived properties.
    """

    def __init__(self, table: Table, index: int) -> None:
        self._table, self._index = table, index

    def __getattr__(self, name: str) -> Any:
        # `copy` looks up such names before `_table` exists; notebooks look them up as well.
        if name.startswith("_"):
            raise AttributeError(name)
        if name not in dir(self):
            raise AttributeError(f"A row of {type(self._table).__name__} has no {name}.")
        rows = self._table.rows()
        if name in rows:
            return take_rows(rows[name], self._index)
        return getattr(self._table.take(np.array([self._index])), name)[0]

    def __dir__(self) -> list[str]:
        return [*self._table.rows(), *self._table.DERIVED]

    def __repr__(self) -> str:
        columns = self._table.take(np.array([self._index])).named_columns(brief=True)
        numbers = ", ".join(
            f"{name}={_brief_number(column[0])}" for name, column in columns.items()
        )
        return f"<{type(self._table).__name__}[{self._index}]: {numbers}>"


def _brief_number(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, (float, np.floating)) else str(value)


def _name_parts(name: str, array: np.ndarray, parts: Sequence[str]) -> dict[str, np.ndarray]:
    """Split an array (n, ...) into scalar columns (n,) by name, one for each number in a row.

    A covariance has columns for its upper triangle.

    name, parts : name of the array, and names of the numbers in a row.
    """
    if array.ndim == 1:
        return {name: array}
    if array.ndim == 3 and array.shape[1] == array.shape[2] == len(parts):
        unit = next((unit for unit in ("_mm", "_px") if parts[0].endswith(unit)), "")
        names = [part.removesuffix(unit) for part in parts]
        return {
            f"cov_{names[i]}_{names[j]}{unit and unit + '2'}": array[:, i, j]
            for i, j in zip(*np.triu_indices(len(parts)), strict=True)
        }
    flat = array.reshape(len(array), int(np.prod(array.shape[1:])))
    names = parts or [f"{name}_{k}" for k in range(flat.shape[1])]
    return dict(zip(names, flat.T, strict=True))


@functools.cache
def list_fields(table: type[Table]) -> tuple[Field, ...]:
    """Declarations of all fields of a class of tables.

    Parameters
    ----------
    table : type
        The class.
    """
    hints = typing.get_type_hints(table, include_extras=True)
    return tuple(_field(field, hints[field.name]) for field in dataclasses.fields(table))


def _field(field: dataclasses.Field, hint: Any) -> Field:
    column = Column()
    if typing.get_origin(hint) is Annotated:
        hint, column = typing.get_args(hint)[:2]
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    members = typing.get_args(hint) if union else (hint,)
    plain = [member for member in members if member is not type(None)]
    optional = len(plain) < len(members) or field.default is not dataclasses.MISSING
    optional |= field.default_factory is not dataclasses.MISSING
    if not hasattr(plain[0], "dim_str"):
        return Field(field.name, plain[0], column, optional, "", ())
    dtypes = plain[0].dtypes if isinstance(plain[0].dtypes, tuple) else ()
    kind = next((kind for kind, dtype in _DTYPES.items() if dtype in dtypes), "U")
    return Field(field.name, plain[0], column, optional, kind, tuple(plain[0].dim_str.split()))


def take_rows(table: _Rows, rows: np.ndarray | slice | int) -> _Rows:
    """Select rows of every column in a tree.

    Parameters
    ----------
    table : tree of (n, ...)
        Columns with n rows.
    rows : array, slice or int
        Indices in the order of the result, a mask, a slice or one index.
    """
    return jax.tree.map(lambda column: column[rows], table)


def concatenate_rows(tables: Sequence[_Rows]) -> _Rows:
    """Concatenate the rows of tables or other trees of columns; at least one tree."""
    return jax.tree.map(lambda *columns: np.concatenate(columns), *tables)


def with_field(options: _Options, name: str, value: Any) -> _Options:
    """Copy of options in which one field has another value.

    Parameters
    ----------
    options : dataclass
        The options, which may contain groups of options.
    name : str
        Name of the field, "field" or "group.field".
    value : any
        The new value.

    Raises
    ------
    ValueError
        If no field has this name.
    """
    group: Any = options
    first, _, rest = name.partition(".")
    field_names = [field.name for field in dataclasses.fields(group)]
    if first not in field_names:
        raise ValueError(f'There is no option "{first}". Choose one of {", ".join(field_names)}.')
    changed = with_field(getattr(group, first), rest, value) if rest else value
    return dataclasses.replace(group, **{first: changed})


# Larger coordinates are errors: no image has so many pixels, no scene so many mm.
LARGEST_PX, LARGEST_MM = 1e6, 1e9
# Smallest eigenvalue, by rounding, of a singular correlation matrix.
_LEAST_EIGENVALUE = -1e-6
_ROUNDING = 1e-9

IN_SCENE = ColumnCheck(
    "is not finite or beyond all scenes", lambda values, _: np.abs(values) < LARGEST_MM
)
IN_PICTURE = ColumnCheck(
    "is not finite or beyond all pictures", lambda values, _: np.abs(values) < LARGEST_PX
)
PICTURE_SIZE = ColumnCheck(
    "must be a width and a height in pixels",
    lambda size, _: len(size) == 2 and all(0 < side < LARGEST_PX for side in size),
)
RADIUS = ColumnCheck("is no radius", lambda values, _: (values > 0) & (values < LARGEST_MM))
FINITE = ColumnCheck("is not finite", lambda values, _: np.isfinite(values))
NOT_INFINITE = ColumnCheck("is infinite", lambda values, _: ~np.isinf(values))
NOT_NEGATIVE = ColumnCheck("is negative", lambda values, _: values >= 0)
SEGMENT_NUMBER = ColumnCheck("is no segment", lambda values, _: values >= 0)
PROBABILITY = ColumnCheck(
    "is no probability", lambda values, _: (values >= 0) & (values <= 1 + _ROUNDING)
)
CHI_SQUARE = ColumnCheck("is no chi-square", lambda values, _: ~(values < 0) & ~np.isinf(values))
COVARIANCE = ColumnCheck("is no covariance", lambda values, _: is_covariance(values))


def check_index(side: str, problem: str, *, smallest: int = 0) -> ColumnCheck:
    """Check that values are indices along an axis.

    The values must be at least `smallest` and less than the length of the axis.

    Parameters
    ----------
    side : str
        Name of the axis.
    problem : str
        Description of a row that fails, as the end of a sentence.
    smallest : int
        Smallest allowed value; -1 for fields in which -1 means "no item".
    """
    return ColumnCheck(
        problem, lambda values, table: (values >= smallest) & (values < table.sides[side])
    )


def is_covariance(matrices: Float[np.ndarray, "n k k"]) -> Bool[np.ndarray, "n"]:
    """Mask of the matrices (n, k, k) that can be covariances.

    They are finite, symmetric and positive semidefinite, up to rounding errors.
    """
    good = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    trusted = np.where(good[:, None, None], matrices, 0.0)
    variance = np.diagonal(trusted, axis1=1, axis2=2)
    sigma = np.sqrt(np.where(variance > 0, variance, 1.0))
    # As correlations, so that degrees and millimetres are comparable.
    unit = trusted / sigma[:, :, None] / sigma[:, None, :]
    good &= (variance >= 0).all(axis=1) & (np.abs(unit) < 2).all(axis=(1, 2))
    unit = np.where(good[:, None, None], unit, 0.0)
    good &= (np.abs(unit - unit.transpose(0, 2, 1)) < 1e-6).all(axis=(1, 2))
    if unit.size:
        good &= np.linalg.eigvalsh(unit).min(axis=1) >= _LEAST_EIGENVALUE
    return good
