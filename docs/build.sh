#!/usr/bin/env bash
# Build the documentation into docs/_build/html: every cell and every command of its pages is run, and
# a failure, a broken link or an unknown name ends the build. `docs/build.sh linkcheck` asks the
# network whether external links lead somewhere.
set -euo pipefail
cd "$(dirname "$0")"
builder=${1:-html}
# Pages' kernels warn that they talk to the build unencrypted, on this computer.
sphinx-build --nitpicky --fail-on-warning --keep-going --quiet -b "$builder" . "_build/$builder" \
    2> >(grep -v "Kernel is running over TCP" >&2)
echo "documentation: docs/_build/$builder"
