"""Imports go one way."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
#: Packages by the folder that they are in; each may import itself and those before it.
LAYERS = {
    "sw": "ukf_sw", "hdl": "ukf_hdl", "sim": "ukf_sim", "tools": "ukf_tools", "docs": "ukf_docs",
    "tests": "support",
}  # fmt: skip


def imported(file):
    """Names of the packages that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.partition(".")[0]


@pytest.mark.parametrize("folder", LAYERS)
def test_imports_go_one_way(folder):
    order = list(LAYERS.values())
    later = set(order[order.index(LAYERS[folder]) + 1 :])
    files = list((ROOT / folder).rglob("*.py"))
    assert files
    wrong = {str(file.relative_to(ROOT)): later & set(imported(file)) for file in files}
    assert {file: names for file, names in wrong.items() if names} == {}
