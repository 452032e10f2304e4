"""Models in C that commands write beside a core."""

from ukf_sw.errors import describe
from ukf_sw.extras import importing
from ukf_sw.problems.placing import example_of
from ukf_sw.spec.core import Core
from ukf_tools.cli.console import print_warning

__all__ = ["models_in_c"]


def models_in_c(core: Core, name: str) -> dict[str, str]:
    """Write the models of a core's problem in C; nothing for a core of sizes alone.

    If that cannot be, a warning says why: the core does not need them.

    Parameters
    ----------
    core
        The core.
    name
        Its name.

    Returns
    -------
    dict
        Contents by name of the file.
    """
    if core.problem is None:
        return {}
    try:
        with importing("golden"):
            from ukf_sw.lowering.c_problem import c_problem_files
            from ukf_sw.lowering.software import software_models
        problem = example_of(core.problem).for_core(core.params)
        return c_problem_files(software_models(problem), name)
    # Models and data are the user's, and may raise anything.
    except Exception as error:
        notes = getattr(error, "__notes__", [])
        reason = str(error) if isinstance(error, (ValueError, ImportError)) else describe(error)
        print_warning(f"no models in C: {'; '.join([reason, *notes])}")
        return {}
