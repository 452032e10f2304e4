"""The documentation as a site."""

import os
import subprocess
import sys
from pathlib import Path

from ukf_docs.site import plain, relink

ROOT = Path(__file__).parents[2]


def test_site_builds_without_warnings(tmp_path):
    """Every page is in the navigation, and every link and anchor exists."""
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", tmp_path],
        cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    # What is about pages alone is only an information, and must not be: hence --quiet, and nothing.
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
    for page in (ROOT / "docs").glob("*.md"):
        assert (tmp_path / page.with_suffix(".html").name).is_file()
    first = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert 'class="mermaid"' in first
    assert 'href="architecture.html"' in first
    assert "UnscentedKalmanFilter" in (tmp_path / "reference.html").read_text(encoding="utf-8")


def test_links_hold_on_both_sides():
    text = "[a](docs/a.md#b) [c](CONTRIBUTING.md) [r](README.md#x)"
    for page in ("index.md", "contributing.md"):
        assert relink(text, page) == "[a](a.md#b) [c](contributing.md) [r](index.md#x)"
    text = "[r](../README.md#b) [c](../CONTRIBUTING.md) [a](a.md)"
    assert relink(text, "usage.md") == "[r](index.md#b) [c](contributing.md) [a](a.md)"


def test_docstrings_become_markdown():
    text = "See :class:`~a.B` and :attr:`c`, like::\n\n    code\n\n::\n\n    more\n"
    assert plain(text) == "See `B` and `c`, like:\n\n    code\n\n\n    more\n"


def test_docstrings_of_components_become_markdown():
    text = (
        "Sum of :py:`a + b`, a :ref:`shape <lang-shape>`.\n\nMembers\n-------\n"
        "a, b : :py:`In(8)`, :py:`In(8)`\n    Of :class:`B`.\n"
    )
    assert plain(text) == (
        "Sum of `a + b`, a shape.\n\nAttributes\n----------\na, b : In(8), In(8)\n    Of `B`.\n"
    )
