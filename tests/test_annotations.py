"""Annotated shapes that run-time checks can hold, read from the annotations themselves.

beartype checks one random member of a container. An axis with a name is then bound to the
length of that member, and the call fails or passes by chance where members differ: within a
container an axis is a number or begins with an underscore, which jaxtyping does not bind.
"""

import ast
import re
from collections.abc import Iterator

import jaxtyping
import pytest

from tests.package import ROOT, list_files, parse_file

# Not containers: one value, or a function, whose arguments nothing checks.
TRANSPARENT = {
    "AbstractVar",
    "Annotated",
    "Callable",
    "ClassVar",
    "Final",
    "Optional",
    "Union",
    "type",
}
UNBOUND = re.compile(r"[*#?]*_\w*|\.\.\.|(\w+=)?\d+")


def is_shape(node: ast.Subscript) -> bool:
    """Return True if `node` is a jaxtyping shape, such as `Float[np.ndarray, "n 2"]`."""
    name = ast.unparse(node.value).split(".")[-1]
    return hasattr(jaxtyping, name) and isinstance(node.slice, ast.Tuple)


def is_container(node: ast.Subscript) -> bool:
    """Return True if `node` has any number of members. A tuple of known length is no container."""
    name = ast.unparse(node.value).split(".")[-1]
    members = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
    if name in ("tuple", "Tuple"):
        return any(isinstance(m, ast.Constant) and m.value is ... for m in members)
    return name not in TRANSPARENT


def shapes_in_containers(
    node: ast.AST, aliases: dict[str, ast.Subscript], inside: bool = False
) -> Iterator[ast.Subscript]:
    """Shapes below `node` that are members of a container, as an alias or written out."""
    if isinstance(node, ast.Subscript):
        if is_shape(node):
            if inside:
                yield node
            return
        yield from shapes_in_containers(node.slice, aliases, inside or is_container(node))
    elif isinstance(node, ast.Name):
        if inside and node.id in aliases:
            yield aliases[node.id]
    elif isinstance(node, ast.Constant) and isinstance(node.value, str) and inside:
        yield from shapes_in_containers(ast.parse(node.value, mode="eval"), aliases, inside)
    else:
        for child in ast.iter_child_nodes(node):
            yield from shapes_in_containers(child, aliases, inside)


def bound_axes(shape: ast.Subscript) -> list[str]:
    """The axes of a shape that jaxtyping binds to a length."""
    assert isinstance(shape.slice, ast.Tuple)
    axes = ast.literal_eval(shape.slice.elts[-1])
    return [axis for axis in axes.split() if not UNBOUND.fullmatch(axis)]


def annotations(tree: ast.AST) -> Iterator[ast.expr]:
    """Yield the annotations of arguments, results, fields and variables."""
    for node in ast.walk(tree):
        if isinstance(node, ast.arg | ast.AnnAssign) and node.annotation is not None:
            yield node.annotation
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.returns is not None:
            yield node.returns


def aliases_of(tree: ast.Module) -> dict[str, ast.Subscript]:
    """The names that a module gives to shapes, such as `Scalar = Float[Array, ""]`."""
    return {
        target.id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        and isinstance(node.value, ast.Subscript)
        and is_shape(node.value)
        for target in node.targets
        if isinstance(target, ast.Name)
    }


def test_no_axis_within_a_container_has_a_name():
    package = {path.relative_to(ROOT).as_posix(): parse_file(path) for path in list_files()}
    aliases = {n: shape for tree in package.values() for n, shape in aliases_of(tree).items()}
    wrong = [
        f"{path}:{annotation.lineno}: {ast.unparse(annotation)}"
        for path, tree in package.items()
        for annotation in annotations(tree)
        for shape in shapes_in_containers(annotation, aliases)
        if bound_axes(shape)
    ]
    assert wrong == []


@pytest.mark.parametrize(
    ("annotation", "is_wrong"),
    [
        ('list[Bool[np.ndarray, "m"]]', True),
        ('Mapping[str, Float[np.ndarray, "_ p"]]', True),
        ('tuple[Float[np.ndarray, "n"], ...] | None', True),
        ('Sequence[tuple[str, Float[np.ndarray, "*n"]]]', True),
        ('list[Bool[np.ndarray, "_"]]', False),
        ('dict[str, Float[np.ndarray, "_views 4 xyz=3"]]', False),
        ('tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 2"]]', False),
        ('Callable[[Float[np.ndarray, "p 2"]], list[int]]', False),
        ('Float[np.ndarray, "h w"] | None', False),
    ],
)
def test_the_reader_of_annotations_sees_what_it_should(annotation: str, is_wrong: bool):
    shapes = shapes_in_containers(ast.parse(annotation, mode="eval"), {})
    assert any(bound_axes(shape) for shape in shapes) == is_wrong
