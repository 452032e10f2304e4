"""``python -m ukf_tools`` is ``ukf``."""

import signal
import sys

from ukf_sw.extras import MissingExtraError, require

__all__ = ["main"]


def main() -> None:
    """Run the command, or say what it needs."""
    # An import that is interrupted can raise anything; without Python's handler it just ends.
    handler = signal.getsignal(signal.SIGINT)
    if handler is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        require("tools")
    except MissingExtraError as error:
        sys.exit(f"Error: {error}")
    from ukf_tools.cli import app

    signal.signal(signal.SIGINT, handler)
    app(prog_name="ukf")


if __name__ == "__main__":
    main()
