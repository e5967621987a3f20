#!/usr/bin/env bash
# Build the documentation into docs/_build/html: every cell and every command of its pages is run, and
# a failure, a broken link or an unknown name ends the build. `docs/build.sh linkcheck` asks the
# network whether external links lead somewhere.
set -euo pipefail
cd "$(dirname "$0")"
builder=${1:-html}
sphinx-build --nitpicky --fail-on-warning --keep-going --quiet -b "$builder" . "_build/$builder"
echo "documentation: docs/_build/$builder"
