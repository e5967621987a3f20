"""Where the files of the repository are, for tests and the programs beside them."""

import json
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "examples" / "scenes"
DATA = ROOT / "tests" / "data"
SUPPORT = ROOT / "tests" / "support"
WORKED = json.loads((DATA / "worked_examples.json").read_text())["examples"]
"""Inputs and expected numbers of the worked examples."""
