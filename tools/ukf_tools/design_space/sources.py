"""What a result depends on in this project, as a digest of its source files."""

import ast
import hashlib
from functools import cache
from importlib.util import find_spec
from pathlib import Path

__all__ = ["closure", "digest"]

#: Packages of this project.
_PACKAGES = ("ukf_sw", "ukf_hdl", "ukf_sim", "ukf_tools")


def _file(module: str) -> Path | None:
    """Source of a module of this project, or None if there is no such module."""
    if module.partition(".")[0] not in _PACKAGES:
        return None
    try:
        spec = find_spec(module)
    except ModuleNotFoundError:  # a name in a module, and not a module
        return None
    return None if spec is None or spec.origin is None else Path(spec.origin)


def _imports(file: Path) -> set[str]:
    """Names that a file imports, in functions as well; names in modules are among them."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return names


@cache
def closure(*modules: str) -> dict[str, Path]:
    """Modules of this project that some modules import, themselves and their packages included.

    Returns
    -------
    dict
        Source file of each module, by rising name.

    Raises
    ------
    ValueError
        If one of the modules is not of this project.
    """
    found: dict[str, Path] = {}
    waiting = list(modules)
    for module in modules:
        if _file(module) is None:
            raise ValueError(f"module must be one of {', '.join(_PACKAGES)}, not {module!r}")
    while waiting:
        module = waiting.pop()
        if module in found:
            continue
        file = _file(module)
        if file is None:
            continue
        found[module] = file
        waiting += _imports(file)
        package = module.rpartition(".")[0]
        if package:
            waiting.append(package)
    return dict(sorted(found.items()))


@cache
def digest(*modules: str) -> str:
    """Digest of everything in this project that some modules are made of, as a hex number.

    That is the source of all that they import, and the data files of packages among it.

    Raises
    ------
    ValueError
        If one of the modules is not of this project.
    """
    total = hashlib.sha256()
    for module, file in closure(*modules).items():
        files = [file]
        if file.name == "__init__.py":
            files += sorted(
                other
                for other in file.parent.iterdir()
                if other.is_file() and other.suffix != ".py"
            )
        for each in files:
            content = hashlib.sha256(each.read_bytes()).hexdigest()
            total.update(f"{module} {each.name} {content}\n".encode())
    return total.hexdigest()
