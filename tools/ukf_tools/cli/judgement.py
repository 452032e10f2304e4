"""Printed verdicts of a run: its accuracy, and why it stopped."""

from rich.table import Table

from ukf_sw.problems.judging import Judgement
from ukf_sw.problems.running import Run
from ukf_tools.cli.console import number, print_warning, results

__all__ = ["name_of", "print_judgement", "print_stop"]

#: A mean NIS that is this many times what is to be expected is not a matter of tuning.
_SUSPICIOUS = 10.0


def name_of(error: str, unit: str) -> str:
    """Name an error with its unit."""
    return f"{error} / {unit}" if unit else error


def print_stop(found: Run) -> None:
    """Print why a run ended early, if it did, and its last good estimate."""
    stop = found.stop
    if stop is not None:
        where = "" if stop.step is None else f", in {stop.step}"
        code = "" if stop.code is None else f", code {stop.code}"
        index = "" if stop.index is None else f", index {stop.index}"
        results.print(
            f"[bold yellow]Stopped[/] after {stop.iteration} iterations{where}: "
            f"{stop.error}{code}{index}. {stop.message}.",
            soft_wrap=True,
        )
        values = [] if found.last_x is None else found.last_x.tolist()
        last = ", ".join(f"{value:.6g}" for value in values)
        results.print(f"Last good estimate: ({last})", soft_wrap=True)


def print_judgement(judged: Judgement) -> None:
    """Print the errors of runs, if the truth is known, and the NIS of each sensor."""
    if judged.errors:
        _print_errors(judged)
    elif judged.steps:
        results.print("No truth, so no errors.")
    if judged.sensors:
        table = Table("sensor", "updates", "mean NIS", "rows sampled, the NIS to expect")
        for column in table.columns[1:]:
            column.justify = "right"
        for sensor in judged.sensors:
            nis = f"{sensor.nis:.2f}" if sensor.nis < 1e6 else number(sensor.nis)
            table.add_row(sensor.name, str(sensor.updates), nis, f"{sensor.rows:.4g}")
        results.print(table)
        for sensor in judged.sensors:
            if not sensor.nis < _SUSPICIOUS * sensor.rows:
                print_warning(
                    f"The mean NIS of {sensor.name} is {number(sensor.nis)} where "
                    f"{sensor.rows:.4g} is to be expected: is its noise, a unit or its model wrong?"
                )
    if judged.largest_difference_of_x is not None:
        ratio = "" if judged.rms_ratio is None else f"ratio of rms {number(judged.rms_ratio)}; "
        results.print(
            f"Beside the reference: {ratio}largest difference of x "
            f"{number(judged.largest_difference_of_x)}"
        )


def _print_errors(judged: Judgement) -> None:
    """Print the errors of runs."""
    reference = judged.reference
    after = "" if judged.since is None else f", from {judged.since:g} s on"
    results.print(f"Errors over {judged.steps} steps{after}:")
    table = Table()
    for heading in ("error", "rms", "largest", *(["rms of the reference"] if reference else [])):
        table.add_column(heading, justify="left" if heading == "error" else "right")
    for k, error in enumerate(judged.errors):
        row = [name_of(error.name, error.unit), number(error.rms), number(error.maximum)]
        if reference is not None:
            row.append(number(reference.errors[k].rms))
        table.add_row(*row)
    results.print(table)
    if judged.limit is not None:
        first = judged.errors[0]
        also = f", reference {reference.below_limit:.2%}" if reference else ""
        results.print(
            f"{first.name.capitalize()} below {judged.limit:g} {first.unit}: "
            f"{judged.below_limit:.2%} of steps{also}"
        )
