"""Convert docstrings for their page: sections in bold, and "name : description" as a list."""

import re
from typing import Any

import griffe


class DocstringMarkdown(griffe.Extension):
    """Converts every docstring to Markdown before it is rendered."""

    def on_object(self, *, obj: Any, **_: Any) -> None:
        """Rewrite the docstring of a module, class or function."""
        if obj.docstring is not None:
            obj.docstring.value = as_markdown(obj.docstring.value)


def as_markdown(text: str) -> str:
    """Markdown of a docstring: underlined words as sections, "x, y : ..." as list items."""
    text = re.sub(r"(?m)^([A-Z]\w+)\n-{3,}$", r"\n**\1**\n", text)
    # The tree of errors is drawn with lines.
    text = re.sub(r"(?m)^(.*\n(?:[├└│].*\n?)+)", r"```text\n\1\n```\n", text)
    lines, listed, source = [], False, text.splitlines()
    for line, following in zip(source, [*source[1:], ""]):
        item = re.match(r"^([\w.*]+(?:, [\w.*]+)*) : (.*)", line)
        if item:
            # In NumPy's layout a type stands here, and the description begins on the next line.
            is_type = re.match(r"    [A-Z]", following) and not item[2].endswith((".", ","))
            description = f" ({item[2]}):" if is_type else f": {item[2]}"
            lines += ([] if listed else [""]) + [f"- `{item[1]}`{description}"]
        else:
            lines.append(line)
        listed = bool(item) or (listed and line.startswith("    "))
    return "\n".join(lines)
