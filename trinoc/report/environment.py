"""How the templates of all pages are read."""

import jinja2


def environment() -> jinja2.Environment:
    """Names that a page lacks raise, and what users wrote is never markup."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader("trinoc.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
