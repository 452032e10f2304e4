"""Command line of the documents: ``python -m ukf_docs``."""

from pathlib import Path
from typing import Annotated

import typer

from ukf_docs import DOCS
from ukf_docs.studies import STUDIES
from ukf_docs.studies.study import Study
from ukf_sw.spec.float_format import FORMATS, FloatFormat
from ukf_tools.cli.console import fail, print_files, progress_teller, results

# What takes long to import is imported by the commands that need it.

__all__ = ["app"]

app = typer.Typer(
    name="python -m ukf_docs",
    help="Tables, figures and printed results of this repository's documents.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_show_locals=False,
)


@app.command("refresh")
def refresh() -> None:
    """Make all tables and diagrams again that derive from the code or from noted measurements."""
    from ukf_docs.diagrams import FOLDER, draw
    from ukf_docs.documents import DOCUMENTS

    print_files(draw(FOLDER))
    for document in DOCUMENTS:
        _update(document)


def _update(document: Path) -> None:
    from ukf_docs.documents import make_sections
    from ukf_docs.sections import update

    if update(document, make_sections(document)):
        print_files([document])


def _study(name: str) -> Study:
    """Give the study of a name."""
    if name not in STUDIES:
        raise typer.BadParameter(f"NAME must be one of {', '.join(STUDIES)}, not {name!r}")
    return STUDIES[name]


def _format(name: str) -> FloatFormat:
    """Give the format of a name."""
    try:
        return FloatFormat.from_name(name)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


@app.command("measure")
def measure(
    studies: Annotated[
        list[Study],
        typer.Argument(metavar="NAME...", help=f"Of {', '.join(STUDIES)}.", parser=_study),
    ],
) -> None:
    """Make the measurements of studies, note them in docs/measured, and refresh their tables."""
    from ukf_sim.simulators import SimulatorError
    from ukf_tools.baseline.executable import BaselineError

    for study in studies:
        with progress_teller() as tell:
            try:
                record = study.measure(tell)
            except (SimulatorError, BaselineError, RuntimeError) as error:
                fail(str(error), 1)
        study.write(record)
        _update(study.document)
        for section in study.tables:
            results.print(study.section(section), highlight=False, soft_wrap=True, markup=False)


@app.command("pages")
def pages() -> None:
    """Execute the code of the pages that have some, and put what it prints into them."""
    from ukf_docs.pages import PAGES, refresh

    for page in PAGES:
        page.write_text(refresh(page.read_text(encoding="utf-8")), encoding="utf-8")


@app.command("applications")
def applications(
    source: Annotated[
        Path, typer.Option("--results", help="Folder that `ukf apps all` wrote to.")
    ] = Path("build/apps"),
) -> None:
    """Put the results of `ukf apps all` into docs/applications.md and docs/figures."""
    from ukf_docs.applications import DOCUMENT, copy_figures, read, sections
    from ukf_docs.sections import update

    try:
        records, study = read(source)
        copies = copy_figures(records, DOCS / "figures")
        update(DOCUMENT, sections(records, study))
    except OSError as error:
        fail(f"{error.filename}: {error.strerror}; run `ukf apps all` first", 1)
    except ValueError as error:
        fail(str(error), 1)
    size = sum(file.stat().st_size for file in copies)
    results.print(f"{len(copies)} figures, {size} bytes", highlight=False)


@app.command("coefficients")
def coefficients(
    formats: Annotated[
        list[FloatFormat] | None,
        typer.Argument(
            metavar="[FORMAT...]",
            help="Formats to make anew, the others stay; without any, those with usual names.",
            parser=_format,
        ),
    ] = None,
) -> None:
    """Make the coefficients of the elementary functions (minutes for binary64)."""
    from ukf_docs.coefficients import FILE, refresh

    with progress_teller() as tell:
        try:
            refresh(FILE, formats or tuple(FORMATS.values()), tell)
        except ValueError as error:
            fail(str(error), 1)
    print_files([FILE])


@app.command("convert")
def convert(
    kind: Annotated[str, typer.Argument(help="inertial (needs SciPy) or odometry.")],
    source: Annotated[Path, typer.Argument(help="File of its authors.")],
    destination: Annotated[Path, typer.Argument(help="File to write.")],
) -> None:
    """Convert recorded data to the files of the package, sw/ukf_sw/problems/data."""
    from ukf_docs.convert import convert_inertial, convert_odometry

    converters = {"inertial": convert_inertial, "odometry": convert_odometry}
    if kind not in converters:
        fail(f"KIND must be one of {', '.join(converters)}, not {kind!r}")
    try:
        file = converters[kind](source, destination)
    except OSError as error:
        fail(f"{source}: {error.strerror or error}", 1)
    except ValueError as error:
        fail(str(error), 1)
    print_files([file])


if __name__ == "__main__":
    app()
