#!/usr/bin/env bash
# Set up everything on a fresh machine (Debian or Ubuntu) and run all checks:
# a virtual environment, Chromium for the browser tests, lint, types, tests, examples, documentation.
set -euo pipefail
cd "$(dirname "$0")/.."

if ! command -v chromium >/dev/null && ! command -v google-chrome >/dev/null; then
    echo "== installing Chromium"
    sudo=$([ "$(id -u)" = 0 ] || echo sudo)
    $sudo apt-get update -qq
    $sudo apt-get install -y -qq --no-install-recommends chromium
fi

# Else each of the hundreds of processes below would compile the package's sources itself.
unset PYTHONDONTWRITEBYTECODE

environment=${MULTIARM_VENV:-.venv}
echo "== installing multiarm into $environment"
[ -d "$environment" ] || python3 -m venv "$environment"
# shellcheck disable=SC1091
. "$environment/bin/activate"
python -m pip install --quiet --disable-pip-version-check -e ".[test,docs]"

echo "== lint, spelling and types"
ruff check .
ruff format --check .
codespell
mypy

# Beforehand: each of the workers would compile what it lacks, and two compile the same at once.
echo "== compiling the kernels (once)"
case " $* " in
*" --quick "*) python examples/01_two_ur5_box.py ;;
*)
    multiarm warmup
    # The parts of the solvers that only tests call from Python.
    python tests/support/search_random_systems.py --family generic --number 1
    ;;
esac

echo "== tests"
# A file goes to one worker: fixtures of modules are made once.
python -m pytest -n 2 --dist loadfile "$@"

case " $* " in
*" --quick "*) ;;
*)
    echo "== documentation"
    bash docs/build.sh
    ;;
esac
