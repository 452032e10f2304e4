"""Command ``ukf latency``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from ukf_sw.spec.core import Core
from ukf_sw.spec.sequence import Program, Routine
from ukf_tools.cli.console import JsonOption, fail, print_json, progress_bars, results
from ukf_tools.cli.names import with_sensor
from ukf_tools.cli.options import with_core
from ukf_tools.cli.paths import IMAGES, file_option
from ukf_tools.cli.programs import ProgramOption, chosen

# What takes long to import is imported by the command itself.
if TYPE_CHECKING:
    from ukf_sw.engine.microcode import Microcode
    from ukf_tools.estimate.explanation import Explanation
    from ukf_tools.estimate.recommendation import Choice

__all__ = ["latency"]


@with_core
def latency(
    core: Core,
    explain: Annotated[
        bool,
        typer.Option(
            "--explain",
            help="Say where the clocks of each program go, and which numbers of PEs are good.",
        ),
    ] = False,
    program: ProgramOption = None,
    plot: Annotated[
        Path | None,
        file_option(
            "--plot", f"Image to draw of a program, or of UPDATE: {', '.join(IMAGES)}.", IMAGES
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Print the cycles of every step, from the schedule: what the core's counter will read.

    An iteration is a predict, with new sigma points if the problem draws them there, and an update
    with every sensor; with both models on the core its first two steps are one. With --program,
    what --explain and --plot give is about that program alone.
    """
    if program is not None and not explain and plot is None:
        fail("--program must come with --explain or --plot, of which it is the program")
    from ukf_sw.engine.microcode import microcode
    from ukf_tools.estimate.latency import latency as compute

    code = microcode(core.params, core.pipeline)
    routines = chosen(program, code.programs)
    record = compute(core.params, core.pipeline, redraws=core.redraws) | core.record()
    explained: list[Explanation] = []
    choices: list[Choice] = []
    if explain:
        from ukf_tools.estimate.recommendation import RULE

        explained = _explanations(code, routines)
        record["explanations"] = [each.record() for each in explained]
        if program is None:
            choices = _choices(core)
            record["pes"] = {"rule": RULE, "choices": [each._asdict() for each in choices]}
    if plot is not None:
        from ukf_tools.estimate.schedule_plot import plot_schedule

        drawn = Routine(Program.UPDATE) if program is None else routines[0]
        plot_schedule(plot, code, drawn, f"{code.name_of(drawn)}: {core.title}")
        record["plot"] = str(plot)
    if as_json:
        print_json(record)
        return
    results.print(f"[bold]{core.title}[/]", soft_wrap=True)
    if program is None or not explain:
        _print_steps(core, record)
    for each in explained:
        _print_explanation(core, each)
    if choices:
        _print_choices(core, choices)
    if plot is not None:
        results.print(f"Plot: {plot}", soft_wrap=True)


def _explanations(code: "Microcode", routines: list[Routine]) -> "list[Explanation]":
    """Explain programs, with a bar meanwhile."""
    from ukf_tools.estimate.explanation import explain

    found: list[Explanation] = []
    with progress_bars() as bars:
        bar = bars.add_task("Explaining the programs", total=len(routines))
        for each in routines:
            found.append(explain(code, each))
            bars.advance(bar)
    return found


def _choices(core: Core) -> "list[Choice]":
    """Compare numbers of processing elements, with a bar meanwhile."""
    from ukf_tools.estimate.recommendation import choices

    with progress_bars() as bars:
        bar = bars.add_task("Scheduling for other numbers of PEs", total=None)

        def tell(done: int, total: int) -> None:
            bars.update(bar, completed=done, total=total)

        return choices(core.params, core.pipeline, redraws=core.redraws, tell=tell)


def _print_steps(core: Core, record: dict[str, Any]) -> None:
    """Print the cycles of steps and programs."""
    table = Table()
    table.add_column("step")
    table.add_column("cycles", justify="right")
    for name, cycles in record["steps"].items():
        table.add_row(with_sensor(name, core.problem), str(cycles))
    table.add_row("total", str(record["total"]), style="bold", end_section=True)
    for name, cycles in record["programs"].items():
        table.add_row(with_sensor(name, core.problem), str(cycles))
    results.print(table)
    drawn = (
        "SIG_GEN is the drawing of new points after PREDICT."
        if core.redraws
        else "Nothing is drawn between PREDICT and UPDATE."
    )
    models = core.params.models
    if models:
        drawn += " F is the process model and PREDICT." if models.f is not None else ""
        drawn += " H is the observation model and UPDATE." if models.h else ""
        if models.f is not None and models.h:
            drawn += " ITERATE is F and H"
            drawn += "." if core.redraws else ", and the total has it in their place."
    results.print(
        f"{drawn} Bus words of an iteration: {record['bus_words']}. An UPDATE leaves the next "
        "sigma points; a PREDICT after a PREDICT draws them first, by SIG_GEN_PREDICTED. Below the "
        "total: each program from start to end; UPDATE_REDRAWN is an UPDATE from points that were "
        "drawn just before.",
        soft_wrap=True,
    )


def _print_explanation(core: Core, found: "Explanation") -> None:
    """Print where the clocks of a program go."""
    from ukf_tools.estimate.waits import Reason

    idle, lanes = len(found.idle), found.lanes
    name = with_sensor(found.name, core.problem)
    reasons = ", ".join(f"{count} {reason.value}" for reason, count in found.reasons.items())
    bounds = ", ".join(f"{name} {clocks}" for name, clocks in found.bounds.items())
    of_beats, of_clocks = (_share(lanes.useful, all_) for all_ in lanes[1:])
    results.print(
        f"\n[bold]{name}[/]: {found.length} clocks, {found.ratio:.2f} times the largest of what "
        f"it takes at least\n"
        f"  at least: {bounds}\n"
        f"  with an issue: {found.length - idle}, without: {idle}, of these {reasons}\n"
        f"  useful lanes: {of_beats} of those of beats that multiply, {of_clocks} of all clocks\n"
        "  the longest chain of operations that wait for each other, for what they wait:",
        soft_wrap=True,
    )
    table = Table()
    table.add_column("part")
    for heading in ("from", "clocks", "result", "issue slot", "stage"):
        table.add_column(heading, justify="right")
    table.add_column("operations")
    for stretch in found.stretches:
        waited = sum(stretch.stage_clocks.values())
        slot = stretch.stage_clocks.get(Reason.ISSUE, 0)
        spent = (stretch.clocks, stretch.clocks - waited, slot, waited - slot)
        table.add_row(stretch.name, str(stretch.first), *map(str, spent), stretch.text)
    results.print(table)


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.0%}" if whole else "-"


def _print_choices(core: Core, choices: "list[Choice]") -> None:
    """Print what numbers of processing elements give."""
    from ukf_tools.estimate.recommendation import RULE

    results.print("\n[bold]Numbers of PEs[/] for this problem:")
    table = Table()
    headings = ("PEs", "beats of a row", "cycles", "speedup per PE")
    for heading in headings:
        table.add_column(heading, justify="right")
    table.add_column("")
    for each in choices:
        table.add_row(
            str(each.pes), str(each.beats), str(each.cycles),
            f"{each.speedup_per_pe:.2f}", "recommended" if each.recommended else "",
            style="bold" if each.pes == core.params.pes else None,
        )  # fmt: skip
    results.print(table)
    good = ", ".join(str(each.pes) for each in choices if each.recommended)
    fastest = min(choices, key=lambda each: (each.cycles, each.pes))
    results.print(f"Recommended: {good}. Fastest: {fastest.pes}. {RULE}", soft_wrap=True)
