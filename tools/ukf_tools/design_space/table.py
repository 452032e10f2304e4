"""Rows of figures as files: Parquet and CSV."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ukf_sw.extras import importing
from ukf_tools.design_space.rows import COLUMNS

__all__ = ["TableError", "read", "write"]


class TableError(RuntimeError):
    """A table cannot be read."""


def _polars() -> Any:
    with importing("sweep"):
        import polars
    return polars


def write(rows: Sequence[dict[str, Any]], folder: Path) -> list[Path]:
    """Write rows to ``sweep.parquet`` and ``sweep.csv``.

    Parameters
    ----------
    rows
        Rows with the entries of :data:`ukf_tools.design_space.rows.COLUMNS`.
    folder
        Where to; made if absent.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    MissingExtraError
        If Polars is not installed.
    OSError
        If the folder cannot be written to.
    """
    polars = _polars()
    kinds = {str: polars.String, int: polars.Int64, float: polars.Float64,
             bool: polars.Boolean}  # fmt: skip
    schema = {name: kinds[column.kind] for name, column in COLUMNS.items()}
    frame = polars.DataFrame(list(rows), schema=schema)
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / "sweep.parquet", folder / "sweep.csv"]
    frame.write_parquet(files[0])
    frame.write_csv(files[1])
    return files


def read(file: Path) -> list[dict[str, Any]]:
    """Read the rows of a Parquet file that a sweep wrote.

    Raises
    ------
    MissingExtraError
        If Polars is not installed.
    TableError
        If the file is not of a sweep.
    FileNotFoundError
        If there is no such file.
    """
    polars = _polars()
    try:
        frame = polars.read_parquet(file)
    except polars.exceptions.PolarsError as error:
        raise TableError(f"{file} must be a Parquet file: {error}") from error
    if frame.columns != list(COLUMNS):
        raise TableError(f"{file} must have the columns of a sweep, not {frame.columns!r}")
    return frame.to_dicts()
