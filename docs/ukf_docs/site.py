"""Documentation as a site: hooks of MkDocs, and of Griffe, which reads the docstrings.

The README is the first page, links hold on GitHub and on the site, and the reStructuredText of the
docstrings becomes Markdown.
"""

import re
from pathlib import Path
from typing import Any

from griffe import Extension, Object

__all__ = ["Docstrings", "on_files", "on_page_markdown", "plain", "relink"]

INDEX = "index.md"


def relink(markdown: str, page: str) -> str:
    """Change links between the README and the pages of docs/, which stand side by side on the site.

    Parameters
    ----------
    markdown
        Text of a page.
    page
        Its path below docs/; index.md is the README.
    """
    if page == INDEX:
        return markdown.replace("](docs/", "](")
    return markdown.replace("](../README.md", f"]({INDEX}")


def on_files(files: Any, config: Any) -> Any:
    """Add the README."""
    from mkdocs.structure.files import File

    readme = Path(config.config_file_path).parent / "README.md"
    files.append(File.generated(config, INDEX, abs_src_path=str(readme)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Change the links of a page."""
    return relink(markdown, page.file.src_uri)


def plain(docstring: str) -> str:
    """Turn the reStructuredText of a docstring, roles and literal blocks, into Markdown."""
    docstring = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", docstring)
    docstring = re.sub(r"^( *)::\n", "", docstring, flags=re.MULTILINE)
    return re.sub(r"::$", ":", docstring, flags=re.MULTILINE)


class Docstrings(Extension):
    """Hook of Griffe that changes every docstring."""

    def on_instance(self, *, obj: Object, **_: Any) -> None:
        """Change the docstring of a module, class or function."""
        if obj.docstring is not None:
            obj.docstring.value = plain(obj.docstring.value)
