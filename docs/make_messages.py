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
# "Return the warning that two cameras ..." gives the cause "Two cameras ...".
_RETURN = re.compile(r"^Return the (?:[\w ]+? (?:that follows if|that names|that|of) )(\w)")
# Stands for a number, a name or a part of the text that depends on the case.
VALUE = "…"
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
    """Cause and text of every public function of a file of sentences."""
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if not isinstance(node, ast.FunctionDef) or node.name.startswith("_"):
            continue
        cause = (ast.get_docstring(node) or "").split("\n\n")[0].replace("\n", " ")
        cause = _PARAMETERS.sub("", cause).rstrip(";.") + "."
        cause = _RETURN.sub(lambda start: start[1].upper(), cause)
        returned = [part.value for part in ast.walk(node) if isinstance(part, ast.Return)]
        texts = [text for value in returned if value and re.search(r"\w", text := _template(value))]
        if texts:
            yield cause, "<br>".join(text.replace("|", "\\|") for text in texts)


def _template(value: ast.expr) -> str:
    """Text of an expression, with `VALUE` for all that it computes."""
    match value:
        case ast.Constant(str(text)):
            return text
        case ast.JoinedStr(values):
            text = "".join(map(_template, values))
        case ast.BinOp(left, ast.Add(), right):
            text = _template(left) + _template(right)
        case ast.Call(_, arguments) if any(isinstance(a, ast.JoinedStr) for a in arguments):
            text = f" {VALUE} ".join(map(_template, arguments))
        case _:
            text = VALUE
    return re.sub(rf"{VALUE}(\s*{VALUE})+", VALUE, text)


if __name__ == "__main__":
    PAGE.write_text(with_messages(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
