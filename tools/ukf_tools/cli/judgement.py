"""Printed verdicts of a run: its accuracy, and why it stopped."""

from typing import Any

from rich.table import Table

from ukf_tools.cli.console import number, results

__all__ = ["print_accuracy", "print_stop"]


def print_stop(record: dict[str, Any]) -> None:
    """Print why a run ended early, if it did, and its last good estimate."""
    stopped = record["stopped"]
    if stopped is not None:
        index = "" if stopped["index"] is None else f", index {stopped['index']}"
        results.print(
            f"[bold yellow]Stopped[/] after {stopped['iteration']} iterations, in "
            f"{stopped['step']}: {stopped['error']}, code {stopped['code']}{index}. "
            f"{stopped['message']}.",
            soft_wrap=True,
        )
        last = ", ".join(f"{value:.6g}" for value in record["last_estimate"] or [])
        results.print(f"Last good estimate: ({last})", soft_wrap=True)


def print_accuracy(judged: dict[str, Any]) -> None:
    """Print the errors of a run."""
    if not judged:
        return
    reference = judged.get("reference")
    after = f", from {judged['since']:g} s on" if judged["since"] else ""
    results.print(f"Errors over {judged['steps']} steps{after}:")
    table = Table()
    for heading in ("error", "rms", "largest", *(["rms of the reference"] if reference else [])):
        table.add_column(heading, justify="left" if heading == "error" else "right")
    for name, unit in judged["units"].items():
        row = [f"{name} / {unit}" if unit else name]
        row += [number(judged["rms"][name]), number(judged["maximum"][name])]
        if reference:
            row.append(number(reference["rms"][name]))
        table.add_row(*row)
    results.print(table)
    if "below_0.1_degrees" in judged:
        also = f", reference {reference['below_0.1_degrees']:.2%}" if reference else ""
        results.print(
            f"Attitude below 0.1 degrees: {judged['below_0.1_degrees']:.2%} of steps{also}"
        )
    if reference:
        results.print(
            f"Ratio of rms to the reference: {number(reference['rms_ratio'])}; largest "
            f"difference of x: {number(reference['largest_difference_of_x'])}"
        )
