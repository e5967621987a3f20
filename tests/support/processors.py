"""Run the tests once for each kind of processor: LAPACK, NumPy and Numba round differently on each.

    python tests/support/processors.py                              # all kinds, the whole suite
    python tests/support/processors.py Prescott generic             # these kinds
    python tests/support/processors.py Haswell -- -n 1 tests/jit  # pytest's arguments after --

SkylakeX (AVX-512), Haswell (AVX2) and Prescott (SSE3) are the kernels of OpenBLAS, of which NumPy
and SciPy have a copy each; `baseline` is NumPy without its optional CPU features; `generic` is
Numba for any x86-64. A kind that the machine lacks is left out, and the table says so. The exit
code is 1 when a test failed on any kind. The whole suite takes as long as usual, once for each.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from repository import ROOT

FEATURES = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
# The environment of each kind, and what `EFFECT` prints where it took effect.
KINDS = {
    "SkylakeX": ({"OPENBLAS_CORETYPE": "SkylakeX"}, ("SkylakeX",)),
    "Haswell": ({"OPENBLAS_CORETYPE": "Haswell"}, ("Haswell",)),
    "Prescott": ({"OPENBLAS_CORETYPE": "Prescott"}, ("Prescott", "Katmai")),
    "baseline": ({"NPY_DISABLE_CPU_FEATURES": " ".join(FEATURES)}, ("baseline",)),
    "generic": ({"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}, ("generic",)),
}
# Uses both copies of OpenBLAS (a processor that lacks a kernel's instructions ends here), then
# prints one word for each library.
EFFECT = """
import numba, numpy, scipy.linalg, threadpoolctl
scipy.linalg.svd(numpy.linalg.inv(numpy.eye(50) + 1.0))
blas = {each["architecture"] for each in threadpoolctl.threadpool_info() if "architecture" in each}
found = numpy.show_config(mode="dicts")["SIMD Extensions"].get("found")
print(*blas, "optional" if found else "baseline", numba.config.CPU_NAME or "host")
"""


def main() -> int:
    """Run what the command line asks for; the exit code."""
    given = sys.argv[1:]
    cut = given.index("--") if "--" in given else len(given)
    kinds, arguments = given[:cut] or list(KINDS), given[cut + 1 :] or ["-n", "2"]
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        raise SystemExit(f"unknown kinds {', '.join(unknown)}; there are {', '.join(KINDS)}")
    table = [("kind", "tests", "passed", "failed", "skipped", "exit code")]
    for kind in kinds:
        table.append((kind, *run(kind, arguments)))
        print("  ".join(map(str, table[-1])), flush=True)
    print()
    for kind, *numbers in table:
        print(f"{kind:<10}" + "".join(f"{number!s:>11}" for number in numbers))
    return int(any(row[-1] not in (0, "not here") for row in table[1:]))


def run(kind: str, arguments: list[str]) -> tuple[object, ...]:
    """Numbers of tests, and pytest's exit code; no numbers where the machine lacks the kind."""
    changes, words = KINDS[kind]
    environment = os.environ | changes
    effect = subprocess.run(
        [sys.executable, "-c", EFFECT], env=environment, capture_output=True, text=True
    )
    print(f"== {kind}: {effect.stdout.strip() or 'crashed'}", flush=True)
    if effect.returncode or not set(words) & set(effect.stdout.split()):
        return "-", "-", "-", "-", "not here"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "results.xml"
        command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", f"--junitxml={file}"]
        code = subprocess.run([*command, *arguments], cwd=ROOT, env=environment).returncode
        if not file.exists():  # pytest did not come to running tests
            return "-", "-", "-", "-", code
        found = ElementTree.parse(file).getroot().find("testsuite").attrib
    count, skipped = int(found["tests"]), int(found["skipped"])
    failed = int(found["failures"]) + int(found["errors"])
    return count, count - failed - skipped, failed, skipped, code


if __name__ == "__main__":
    sys.exit(main())
