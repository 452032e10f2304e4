"""Projects of one's own: a small one that works, to start from."""

import keyword
import re
import sys
from importlib.util import find_spec
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from ukf_sw.folders import check_folder
from ukf_sw.spec.parameters import Noise, UkfParams

__all__ = ["TEMPLATES", "check_name", "write_project"]

#: Files of a project, and the template of each; NAME stands for its name.
TEMPLATES = {
    "README.md": "README.md.jinja",
    "Makefile": "Makefile.jinja",
    "pyproject.toml": "pyproject.toml.jinja",
    ".gitignore": "gitignore.jinja",
    "NAME/__init__.py": "package/__init__.py.jinja",
    "NAME/model.py": "package/model.py.jinja",
    "tests/test_NAME.py": "tests/test_package.py.jinja",
    ".github/workflows/test.yml": "github_workflow.yml.jinja",
    ".gitlab-ci.yml": "gitlab_ci.yml.jinja",
}

#: Names that pytest, Make, Python and the project itself give a meaning.
RESERVED = ("build", "conftest", "makefile", "sitecustomize", "tests", "usercustomize")


def check_name(name: str) -> None:
    """Check the name of a project, which becomes that of a Python package.

    Raises
    ------
    ValueError
        If it cannot be one, would hide another, or has a meaning of its own.
    """
    if not re.fullmatch("[a-z][a-z0-9_]*", name):
        raise ValueError(
            "The name must be lower-case letters, digits and underscores, first a letter, "
            f"not {name!r}"
        )
    if keyword.iskeyword(name):
        raise ValueError(f"The name must not be a word of Python's, not {name!r}")
    if name in RESERVED:
        raise ValueError(
            f"The name must not be one that means something to a tool, {', '.join(RESERVED)}, "
            f"not {name!r}"
        )
    found = find_spec(name)
    # Without an origin it is a mere folder, such as the empty one that is to be filled.
    taken = found is not None and found.origin is not None
    if name in sys.stdlib_module_names or taken:
        raise ValueError(f"The name must not be that of another Python package, not {name!r}")


def write_project(folder: Path, params: UkfParams) -> list[Path]:
    """Write a project: models, data, tests, Makefile, workflows.

    The problem to start from is a heated strut with as many cells as there are states; it makes
    sense for all sizes.

    Parameters
    ----------
    folder
        Folder to make; its name is that of the project. It may exist if it is empty.
    params
        Sizes, noise, number of processing elements.

    Returns
    -------
    list
        The files.

    Raises
    ------
    ValueError
        If the name cannot be one, there are fewer noise terms than observations, or the folder
        cannot be written.
    FileExistsError
        If the folder has files, or is a file.
    """
    name = folder.resolve().name
    if params.r < params.m:
        raise ValueError(
            f"r must be at least m = {params.m}, noise for every sensor, not {params.r!r}"
        )
    if folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
        kind = "file" if folder.is_file() else "folder with files"
        raise FileExistsError(f"DIR must be a new or an empty folder, not the {kind} {folder}")
    check_name(name)
    check_folder("DIR", folder)
    environment = Environment(
        loader=PackageLoader("ukf_tools.new"),
        autoescape=False,  # nothing here is HTML
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    facts = {
        "name": name,
        "p": params,
        "process_augmented": params.process_noise is Noise.AUGMENTED,
        "observation_augmented": params.observation_noise is Noise.AUGMENTED,
    }
    written: list[Path] = []
    for target, template in TEMPLATES.items():
        file = folder / target.replace("NAME", name)
        file.parent.mkdir(parents=True, exist_ok=True)
        text = environment.get_template(template).render(facts)
        file.write_text(text, encoding="utf-8")
        written.append(file)
    return written
