"""``python -m ukf_tools`` is ``ukf``."""

from ukf_tools.cli import app

if __name__ == "__main__":
    app(prog_name="ukf")
