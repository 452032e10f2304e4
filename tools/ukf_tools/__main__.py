"""``python -m ukf_tools`` is ``ukf``."""

import sys

from ukf_sw.extras import MissingExtraError, require

__all__ = ["main"]


def main() -> None:
    """Run the command, or say what it needs."""
    try:
        require("tools")
    except MissingExtraError as error:
        sys.exit(f"Error: {error}")
    from ukf_tools.cli import app

    app(prog_name="ukf")


if __name__ == "__main__":
    main()
