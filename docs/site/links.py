"""Links out of the documentation: the site has no files of the checkout."""

import re

OUT = re.compile(r"\[([^\]]*)\]\(\.\./([^)]*)\)")


def on_page_markdown(markdown: str, **_: object) -> str:
    """Replace each link to a file outside the pages by its path."""
    return OUT.sub(r"`\2`", markdown)
