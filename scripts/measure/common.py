"""Where the checkout and its command are."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
METAFMU = ROOT / "target" / "release" / "metafmu"
