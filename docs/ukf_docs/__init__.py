"""What this repository's documents need and no user of the package does: ``python -m ukf_docs``."""

from pathlib import Path

__all__ = ["DOCS", "README", "ROOT"]

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
DOCS = ROOT / "docs"
