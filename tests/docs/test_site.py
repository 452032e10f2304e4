"""The documentation as a site, also in a browser."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from lxml import html

from support.browser import WIDTHS, open_page, started_browser
from ukf_docs.site import plain, relink

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Build the site; gives its folder."""
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", folder],
        cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    # What is about pages alone is only an information, and must not be: hence --quiet, and nothing.
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
    return folder


def pages_of(site):
    """Pages but that of what is not found, which is made for a server."""
    pages = sorted(file for file in site.glob("*.html") if file.name != "404.html")
    assert len(pages) > 15
    return pages


def test_site_builds_without_warnings(site):
    """Every page is in the navigation, and every link and anchor exists."""
    for page in (ROOT / "docs").glob("*.md"):
        assert (site / page.with_suffix(".html").name).is_file()
    first = (site / "index.html").read_text(encoding="utf-8")
    assert 'src="figures/diagrams/overview.svg"' in first
    assert 'href="architecture.html"' in first
    assert "UnscentedKalmanFilter" in (site / "reference.html").read_text(encoding="utf-8")
    assert (site / "architecture.html").read_text(encoding="utf-8").count("<math ") >= 4


#: Source that should have become a picture, an equation or a list.
UNDRAWN = re.compile(r"\b(?:flowchart|graph) (?:LR|RL|TB|TD|BT)\b|\\begin\{|\$\$|\\frac\b")
UNLISTED = re.compile(r"(?m)^\s*(?:[-*+]|\d+[.)]) ")


def test_sources_have_become_what_they_are_for(site):
    lists = 0
    for page in pages_of(site):
        (content,) = html.parse(page).xpath("//article")
        lists += len(content.xpath(".//li"))
        assert not UNDRAWN.search(content.text_content()), page.name
        for text in content.xpath(".//p | .//td | .//dd | .//li[not(*)]"):
            assert not UNLISTED.search(text.text_content()), f"{page.name}: {text.text_content()}"
    assert lists > 50


@pytest.mark.parametrize(
    ("pattern", "source"),
    [
        (UNDRAWN, "flowchart LR\n  a --> b"),
        (UNDRAWN, "\\begin{aligned}"),
        (UNLISTED, "It has:\n- a\n- b"),
        (UNLISTED, "First\n 1. then"),
    ],
)
def test_sources_are_recognised(pattern, source):
    assert pattern.search(source)
    assert not pattern.search("a graph of P - 1 adders in 2018. Then 3 * 4")


#: What stands out of the screen, but within what scrolls; and code that scrolls.
OUTSIDE = """
() => [...document.querySelectorAll('article *')].filter(e =>
  !e.parentElement.closest('pre, .md-typeset__scrollwrap, .equation, svg') &&
  e.getBoundingClientRect().right > innerWidth + 1).map(e => e.outerHTML.slice(0, 120))
"""
SCROLLED = """
kind => [...document.querySelectorAll(kind + ' pre > code')].filter(e =>
  e.scrollWidth > e.clientWidth + 1).map(e => e.textContent.slice(0, 120))
"""


@pytest.fixture(scope="module")
def browser():
    """Chromium, or a skip that says why."""
    with started_browser() as started:
        yield started


# A narrow one is the harder; the tests of the report are in all widths.
@pytest.mark.parametrize(
    "width",
    [pytest.param(w, marks=[pytest.mark.slow] * (w != min(WIDTHS))) for w in WIDTHS],
)
def test_pages_fit_into_a_browser(site, browser, width):
    """Nothing is cut off: code has its 100 columns in a window, and is wrapped on a phone."""
    for file in pages_of(site):
        with open_page(browser, file, width) as page:
            assert page.evaluate(OUTSIDE) == [], file.name
            # Listings keep their columns on a phone.
            kind = "article" if width == max(WIDTHS) else ".highlight:not(.language-text)"
            assert page.evaluate(SCROLLED, kind) == [], file.name
            missing = "[...document.images].filter(image => !image.naturalWidth).map(i => i.src)"
            assert page.evaluate(missing) == [], file.name


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
