"""The table of messages in messages.md, from the files of sentences: docs/make_messages.py"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

PAGE = Path(__file__).parent / "messages.md"
ROOT = Path(__file__).parent.parent / "trinoc"
FILES = {
    "Calibration": ROOT / "calib" / "sentences.py",
    "Fit to the grey levels": ROOT / "calib" / "photometric" / "sentences.py",
    "Matching": ROOT / "match" / "sentences.py",
}
# From a docstring's first line: the parameters that follow the sentence.
_PARAMETERS = re.compile(r"\s+`?\w+`?(, `?\w+`?)* : .*")
# "Return the warning that two ..." and "Message about two ..." give the cause "Two ...".
_RETURN = re.compile(
    r"^(?:Message (?:about|that)|Return the [\w ]+? (?:that follows if|that names|that|of)) (\w)"
)
# Stands for a part of the text that depends on the case and has no name in the code.
VALUE = "…"
# Functions that only change the form of their first argument.
_PASSED_ON = ("_join", "_quoted")
START, END = "<!-- messages -->\n", "<!-- end of messages -->\n"


def with_messages(page: str) -> str:
    """Replace the tables of the page by those of the code."""
    before, rest = page.split(START)
    after = rest.split(END)[1]
    tables = []
    for title, file in FILES.items():
        rows = "".join(f"| {cause} | {text} |\n" for cause, text in _messages(file))
        tables.append(f"\n## {title}\n\n| cause | message |\n|---|---|\n{rows}")
    return f"{before}{START}{''.join(tables)}\n{END}{after}"


def _messages(file: Path) -> Iterator[tuple[str, str]]:
    """Cause and text of every public function of a file of messages."""
    module = ast.parse(file.read_text(encoding="utf-8"))
    functions = {node.name: node for node in module.body if isinstance(node, ast.FunctionDef)}
    constants = _assignments(module)
    for name, function in functions.items():
        if name.startswith("_"):
            continue
        cause = (ast.get_docstring(function) or "").split("\n\n")[0].replace("\n", " ")
        cause = _PARAMETERS.sub("", cause).rstrip(";.") + "."
        cause = _RETURN.sub(lambda start: start[1].upper(), cause)
        texts = _texts(function, constants, functions)
        if any(re.search(r"\w", re.sub(r"{\w+}", "", text)) for text in texts):
            yield cause, "<br>".join(text.replace("|", "\\|") for text in texts)


def _assignments(scope: ast.Module | ast.FunctionDef) -> dict[str, ast.expr]:
    """Expressions of the texts that a module or a function assigns once to a name."""
    values: dict[str, list[ast.expr]] = {}
    for node in ast.walk(scope) if isinstance(scope, ast.FunctionDef) else scope.body:
        match node:
            case ast.Assign([ast.Name(name)], value):
                values.setdefault(name, []).append(value)
    texts = ast.JoinedStr | ast.IfExp | ast.Constant | ast.Dict
    return {
        name: value[0]
        for name, value in values.items()
        if len(value) == 1 and isinstance(value[0], texts)
    }


def _texts(
    function: ast.FunctionDef,
    constants: dict[str, ast.expr],
    functions: dict[str, ast.FunctionDef],
) -> list[str]:
    """Texts that a function can return. A variable is shown as its name in braces."""
    assigned = constants | _assignments(function)

    def template(value: ast.expr) -> str:
        match value:
            case ast.Constant(str(text)):
                return text
            case ast.JoinedStr(values):
                text = "".join(map(template, values))
            case ast.BinOp(left, ast.Add(), right):
                text = template(left) + template(right)
            case ast.BinOp(ast.Constant(), _, part):
                text = template(part)
            case ast.IfExp(_, first, second):
                choices = [choice for choice in map(template, (first, second)) if choice]
                is_grammar = len(choices) == 2 and all(len(c.split()) <= 3 for c in choices)
                text = choices[1] if is_grammar else f"[{' or: '.join(choices)}]"
            case ast.Name(name) if not isinstance(assigned.get(name), ast.Dict | None):
                text = template(assigned[name])
            case ast.Name(name) | ast.Attribute(_, name):
                text = f"{{{name.lstrip('_').lower()}}}"
            case ast.Subscript(ast.Name(name), ast.Constant(key)) if name in assigned:
                entries = {k.value: v for k, v in zip(assigned[name].keys, assigned[name].values)}
                text = template(entries[key])
            case ast.Call(ast.Name("capitalise"), [part]):
                text = template(part)
                text = text[:1].upper() + text[1:]
            case ast.FormattedValue(part) | ast.Subscript(part):
                text = template(part)
            case ast.GeneratorExp(part) | ast.ListComp(part):
                text = template(part)
            case ast.Call(ast.Attribute(ast.Constant(), "join"), [part]):
                text = template(part)
            case ast.Call(ast.Name(name)) if name in functions and name not in _PASSED_ON:
                text = _texts(functions[name], constants, functions)[-1]
            case ast.Call(ast.Name(), [part, *_]):
                text = template(part)
            case ast.Call(ast.Attribute(part)):
                text = template(part)
            case _:
                text = VALUE
        return re.sub(rf"{VALUE}(\s*{VALUE})+", VALUE, text)

    returned = [part.value for part in ast.walk(function) if isinstance(part, ast.Return)]
    return list(dict.fromkeys(template(value) for value in returned if value))


if __name__ == "__main__":
    PAGE.write_text(with_messages(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
