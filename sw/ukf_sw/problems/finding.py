"""Problems by name: of the catalogue, or of a module and an attribute, as ``strut.model:problem``.

Problems hold functions, which do not pass between processes; their names do.
"""

import hashlib
import importlib
import sys
from pathlib import Path
from types import ModuleType

from ukf_sw.errors import describe
from ukf_sw.problem import Problem
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.entry import Entry

__all__ = ["ProblemNotFoundError", "digest_of_modules", "find", "is_own"]

#: Names of folders of what is installed.
_INSTALLED = {"site-packages", "dist-packages"}


class ProblemNotFoundError(ValueError):
    """There is no such problem; the message says what is missing where."""


def is_own(name: str) -> bool:
    """Whether a name is a module and an attribute, not of the catalogue."""
    return ":" in name


def find(name: str, what: str = "problem", folder: Path | None = None) -> Entry:
    """Find a problem.

    Parameters
    ----------
    name
        Its name.
    what
        What the name is, in the message of the error.
    folder
        Where modules are looked for first; None is the current one.

    Raises
    ------
    ProblemNotFoundError
        If there is none of that name, or its module cannot be imported.
    """
    if not is_own(name):
        if name not in CATALOGUE:
            raise ProblemNotFoundError(
                f"{what} must be one of {', '.join(CATALOGUE)}, or a module and an attribute, as "
                f"strut.model:problem, not {name!r}"
            )
        return CATALOGUE[name]
    module_name, _, attribute = name.partition(":")
    parts = [*module_name.split("."), attribute]
    if not all(part.isidentifier() for part in parts):
        raise ProblemNotFoundError(
            f"{what} must be a module and an attribute, as strut.model:problem, not {name!r}"
        )
    module = _import(module_name, what, folder or Path.cwd())
    problem = getattr(module, attribute, None)
    if not isinstance(problem, Problem):
        kind = "is missing" if problem is None else f"is of the class {type(problem).__name__}"
        others = [key for key, value in vars(module).items() if isinstance(value, Problem)]
        have = f"problems there: {', '.join(others)}" if others else "there is no problem there"
        raise ProblemNotFoundError(
            f"{what} must be a Problem, and {attribute} of {module_name} {kind}; {have}"
        )
    return Entry.of(name, problem)


def _import(name: str, what: str, folder: Path) -> ModuleType:
    """Import a module, from a folder first."""
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
        importlib.invalidate_caches()
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and f"{name}.".startswith(f"{error.name}."):
            raise ProblemNotFoundError(
                f"{what} must be in a module that can be imported, and {error.name} is neither in "
                f"{folder} nor installed"
            ) from error
        raise _failed(what, name, error) from error
    except Exception as error:
        raise _failed(what, name, error) from error


def _failed(what: str, name: str, error: Exception) -> ProblemNotFoundError:
    """Say that a module cannot be imported, and which line of whose is to blame."""
    return ProblemNotFoundError(
        f"{what} must be in a module that can be imported, and {name} cannot: {describe(error)}"
    )


def digest_of_modules(name: str) -> str:
    """Digest of the sources of a problem that has been found in a module, as a hex number.

    They are all modules that have been imported from where its package is: what the project of the
    user consists of, but not what is installed.
    """
    top = sys.modules[name.partition(":")[0].partition(".")[0]]
    package = next(iter(getattr(top, "__path__", [])), None)
    own = Path(package or top.__file__ or "")
    folder = own if _INSTALLED & set(own.parent.parts[-1:]) else own.parent
    total = hashlib.sha256()
    for _, module in sorted(sys.modules.items()):
        file = Path(getattr(module, "__file__", None) or "")
        if file.suffix == ".py" and file.is_relative_to(folder):
            inside = file.relative_to(folder)
            if not _INSTALLED & set(inside.parts):
                content = hashlib.sha256(file.read_bytes()).hexdigest()
                total.update(f"{inside} {content}\n".encode())
    return total.hexdigest()
