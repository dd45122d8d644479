"""Values as tables of columns, each declared once; rows of trees of columns; options in groups.

A table is a frozen Module. Its annotations say the kind and the shape of each column as jaxtyping
does, `Float[np.ndarray, "t 2 3"]`: a side with a name is as long in all columns. `Annotated` adds a
`Column`: what the values must be, and what the numbers of a row are called. The class's docstring
has a sentence on each. Files, frames of pandas, CSV, Parquet and cards follow from these.
At the end stands what values of columns must be.
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

# What jaxtyping's Float, Int and Bool hold; Shaped is for texts.
_DTYPES = {"f": "float64", "i": "int64", "b": "bool"}
# Numbers of a row: both ends of a line in space.
_MOST_BRIEF = 6


class Content(NamedTuple):
    """What was read of a table: values by the names of its fields, and how long its sides are."""

    values: dict[str, Any]
    sides: dict[str, int]


class ColumnCheck(NamedTuple):
    """`good` says of each entry of a value, or of the whole, whether it can be. `problem` is said
    of the first row that cannot."""

    problem: str
    good: Callable[[Any, Content], Any]


class Column:
    """What is to be said of a field beside its kind and its shape.

    Parameters
    ----------
    checks : what the values must be.
    parts : a name for each number of a row, or a function of the table that gives them; of a
        covariance, the names of what it is of.
    side : of names, such as those of views: the side that they number.
    beside : of a dictionary: its arrays have a row for each of the table, and names of their own.
    blocks : of a tuple of square matrices: the number of rows of each.
    below : of a table in a table: what the names of its arrays in a file begin with.
    """

    def __init__(
        self,
        *checks: ColumnCheck,
        parts: Sequence[str] | Callable[[Any], Sequence[str]] = (),
        side: str = "",
        beside: bool = False,
        blocks: Callable[[Content], Sequence[int]] | None = None,
        below: str = "",
    ) -> None:
        self.checks, self.parts, self.side = checks, parts, side
        self.beside, self.blocks, self.below = beside, blocks, below


class Field(NamedTuple):
    """A field of a table; what is no array has no kind ("f", "i", "b" or "U") and no sides."""

    name: str
    type: Any
    column: Column
    optional: bool
    kind: str
    sides: tuple[str, ...]

    @property
    def below(self) -> str:
        """What the names of its arrays begin with, where several stand for it."""
        return "" if self.column.beside else self.column.below or f"{self.name}/"


class Table(Value):
    """A value whose columns are declared.

    `KIND` names it in files, `IN_WORDS` in sentences. `SIDES` has words for what is counted along
    each side with a name; the first are the rows. `DERIVED` are properties with a row for each,
    with names for its numbers; files do not hold them.
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
        """One row, or the table of some: a slice, indices, or a mask, as of a NumPy array.

        Raises IndexError for a row that is not there and for a mask of another length.
        """
        chosen = np.arange(len(self))[rows]
        return TableRow(self, int(chosen)) if np.ndim(chosen) == 0 else self.take(chosen)

    def __iter__(self) -> Iterator["TableRow"]:
        return (TableRow(self, number) for number in range(len(self)))

    def rows(self) -> dict[str, Any]:
        """The fields that have a row for each row of the table, those of a dictionary in one."""
        first = next(iter(self.SIDES))
        held = {field.name: (field, getattr(self, field.name)) for field in list_fields(type(self))}
        return {
            name: value
            for name, (field, value) in held.items()
            if value is not None and (field.sides[:1] == (first,) or field.column.beside)
        }

    def take(self: _TableType, rows: np.ndarray) -> _TableType:
        """The rows at the given indices, in that order, or where the mask is true."""
        return dataclasses.replace(self, **take_rows(self.rows(), rows))

    def append(self: _TableType, rows: Mapping[str, np.ndarray]) -> _TableType:
        """The same with more rows, by the names of their columns.

        Columns that are not given are False, 0 or "" there.
        """
        count = len(next(iter(rows.values())))

        def longer(name: str, column: Any) -> Any:
            if isinstance(column, dict):
                return {own: longer(own, array) for own, array in column.items()}
            none = np.zeros((count, *np.shape(column)[1:]), column.dtype)
            return np.concatenate([np.asarray(column), rows.get(name, none)])

        return dataclasses.replace(
            self, **{name: longer(name, column) for name, column in self.rows().items()}
        )

    def named_columns(self, *, brief: bool = False) -> dict[str, np.ndarray]:
        """A name and a column for each number of a row, or, if brief, without the long rows of
        covariances and pictures; `DERIVED` come last."""
        columns: dict[str, np.ndarray] = {}
        fields = {field.name: field.column for field in list_fields(type(self))}
        for name, value in self.rows().items():
            parts = fields[name].parts
            names = parts(self) if callable(parts) else parts
            for own, array in value.items() if isinstance(value, dict) else [(name, value)]:
                if not brief or np.prod(np.shape(array)[1:]) <= _MOST_BRIEF:
                    columns |= _name_parts(own, np.asarray(array), names)
        for name, parts in self.DERIVED.items():
            columns |= _name_parts(name, np.asarray(getattr(self, name)), parts)
        return columns


class TableRow:
    """One row of a table: its part of each column and property of rows, by that one's name."""

    def __init__(self, table: Table, number: int) -> None:
        self._table, self._number = table, number

    def __getattr__(self, name: str) -> Any:
        # Copying asks for such names before there is a table, and notebooks ask for them, too.
        if name.startswith("_"):
            raise AttributeError(name)
        if name not in dir(self):
            raise AttributeError(f"A row of {type(self._table).__name__} has no {name}.")
        rows = self._table.rows()
        if name in rows:
            return take_rows(rows[name], self._number)
        return getattr(self._table.take(np.array([self._number])), name)[0]

    def __dir__(self) -> list[str]:
        return [*self._table.rows(), *self._table.DERIVED]

    def __repr__(self) -> str:
        own = self._table.take(np.array([self._number])).named_columns(brief=True)
        numbers = ", ".join(f"{name}={_brief_number(column[0])}" for name, column in own.items())
        return f"<{type(self._table).__name__}[{self._number}]: {numbers}>"


def _brief_number(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, (float, np.floating)) else str(value)


def _name_parts(name: str, array: np.ndarray, parts: Sequence[str]) -> dict[str, np.ndarray]:
    """The numbers of each row by name; of covariances, the upper triangle."""
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
    """What a table declares."""
    hints = typing.get_type_hints(table, include_extras=True)
    return tuple(_field(each, hints[each.name]) for each in dataclasses.fields(table))


def _field(field: dataclasses.Field, hint: Any) -> Field:
    column = Column()
    if typing.get_origin(hint) is Annotated:
        hint, column = typing.get_args(hint)[:2]
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    members = typing.get_args(hint) if union else (hint,)
    plain = [each for each in members if each is not type(None)]
    optional = len(plain) < len(members) or field.default is not dataclasses.MISSING
    optional |= field.default_factory is not dataclasses.MISSING
    if not hasattr(plain[0], "dim_str"):
        return Field(field.name, plain[0], column, optional, "", ())
    dtypes = plain[0].dtypes if isinstance(plain[0].dtypes, tuple) else ()
    kind = next((kind for kind, dtype in _DTYPES.items() if dtype in dtypes), "U")
    return Field(field.name, plain[0], column, optional, kind, tuple(plain[0].dim_str.split()))


def take_rows(table: _Rows, rows: np.ndarray | slice | int) -> _Rows:
    """The rows at the given indices, in that order, or where the mask is true, of each column of a
    tree."""
    return jax.tree.map(lambda column: column[rows], table)


def concatenate_rows(tables: Sequence[_Rows]) -> _Rows:
    """The rows of one or more trees of columns, one after the other."""
    return jax.tree.map(lambda *columns: np.concatenate(columns), *tables)


def with_field(options: _Options, name: str, value: Any) -> _Options:
    """The same options with another value of one field, named by "group.field" or "field".

    Raises ValueError for a name that the options do not have.
    """
    group: Any = options
    first, _, rest = name.partition(".")
    own = [field.name for field in dataclasses.fields(group)]
    if first not in own:
        raise ValueError(f'There is no option "{first}": choose one of {", ".join(own)}.')
    changed = with_field(getattr(group, first), rest, value) if rest else value
    return dataclasses.replace(group, **{first: changed})


# Larger numbers are no places: no picture has so many pixels, no scene so many mm.
LARGEST_PX, LARGEST_MM = 1e6, 1e9
# Of correlations: what rounding leaves of a covariance without spread in some direction.
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


def check_number(side: str, problem: str, *, least: int = 0) -> ColumnCheck:
    """A row along a side, or -1 for none where `least` is."""
    return ColumnCheck(
        problem, lambda values, table: (values >= least) & (values < table.sides[side])
    )


def is_covariance(matrices: Float[np.ndarray, "n k k"]) -> Bool[np.ndarray, "n"]:
    """(n,) whether each of (n, k, k) is finite, symmetric and without negative variance."""
    good = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    trusted = np.where(good[:, None, None], matrices, 0.0)
    variance = np.diagonal(trusted, axis1=1, axis2=2)
    sigma = np.sqrt(np.where(variance > 0, variance, 1.0))
    # As correlations, so that degrees and millimetres count alike.
    unit = trusted / sigma[:, :, None] / sigma[:, None, :]
    good &= (variance >= 0).all(axis=1) & (np.abs(unit) < 2).all(axis=(1, 2))
    unit = np.where(good[:, None, None], unit, 0.0)
    good &= (np.abs(unit - unit.transpose(0, 2, 1)) < 1e-6).all(axis=(1, 2))
    if unit.size:
        good &= np.linalg.eigvalsh(unit).min(axis=1) >= _LEAST_EIGENVALUE
    return good
