"""Documentation as a site: hooks of MkDocs, and of Griffe, which reads the docstrings.

The README is the first page, the pages beside it are pages as well, links hold on GitHub and on the
site, and the reStructuredText of the docstrings becomes Markdown.
"""

import re
from pathlib import Path
from typing import Any

from griffe import Extension, Object

__all__ = ["Docstrings", "on_files", "on_page_markdown", "plain", "relink"]

#: Files beside docs/ that are pages of the site, and the pages' names.
BESIDE = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md"}


def relink(markdown: str, page: str) -> str:
    """Change links between the pages of docs/ and those beside it, which the site has in one place.

    Parameters
    ----------
    markdown
        Text of a page.
    page
        Its path on the site.
    """
    beside = page in BESIDE.values()
    for file, target in BESIDE.items():
        markdown = markdown.replace(f"]({'' if beside else '../'}{file}", f"]({target}")
    return markdown.replace("](docs/", "](") if beside else markdown


def on_files(files: Any, config: Any) -> Any:
    """Add the pages beside docs/."""
    from mkdocs.structure.files import File

    root = Path(config.config_file_path).parent
    for file, page in BESIDE.items():
        files.append(File.generated(config, page, abs_src_path=str(root / file)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Change the links of a page."""
    return relink(markdown, page.file.src_uri)


#: A role of reStructuredText: its text, and its target where it is another one.
ROLE = re.compile(r"(?::\w+)+:`(?P<text>[^`<]+?)(?: <(?P<target>[^`]+)>)?`")


def plain(docstring: str) -> str:
    """Turn the reStructuredText of a docstring, as Python and Amaranth have it, into Markdown.

    Roles become code, literal blocks lose their colons. The kind of a parameter or member becomes
    an annotation, and the section "Members" of a component one that Griffe knows.
    """
    docstring = re.sub(r"(?m)^Members\n-------$", "Attributes\n----------", docstring)
    docstring = re.sub(
        r"(?m)^(\w+(?:, \w+)* : )(.*)$",
        lambda line: line[1] + ROLE.sub(r"\g<text>", line[2]),
        docstring,
    )
    docstring = ROLE.sub(_inline, docstring)
    docstring = re.sub(r"(?m)^( *)::\n", "", docstring)
    return re.sub(r"(?m)::$", ":", docstring)


def _inline(role: re.Match[str]) -> str:
    """Show a role within text: the last part of a name that begins with a tilde, as Sphinx does."""
    if role["target"]:
        return role["text"]
    text = role["text"]
    return f"`{text.rpartition('.')[2] if text.startswith('~') else text}`"


class Docstrings(Extension):
    """Hook of Griffe that changes every docstring."""

    def on_instance(self, *, obj: Object, **_: Any) -> None:
        """Change the docstring of a module, class or function."""
        if obj.docstring is not None:
            obj.docstring.value = plain(obj.docstring.value)
