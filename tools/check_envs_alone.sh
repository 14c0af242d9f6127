#!/usr/bin/env bash
# Builds the moral-envs wheel, installs it into a fresh virtual environment that has no torch, and runs the
# environment tests there: what a user of the environments alone gets. Arguments go to pytest.
# Run by `make test`, which has made .venv; PIP_ARGS goes to pip.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

alone=$(mktemp -d)
trap 'rm -rf "$alone"' EXIT
python="$alone/venv/bin/python"
pip() { .venv/bin/python -m pip --disable-pip-version-check --quiet "$@"; }
# shellcheck disable=SC2086  # PIP_ARGS holds several words
install() { pip --python "$python" install --no-compile -c constraints.txt ${PIP_ARGS:-} "$@"; }

pip wheel --no-deps --no-build-isolation --wheel-dir "$alone" ./envs
.venv/bin/python -m venv --without-pip "$alone/venv"
install "$alone"/moral_envs-*.whl
"$python" -c 'import moral_envs'   # its declared dependencies suffice
install --group test-envs
install --no-deps --group peers
"$python" - <<'CHECK'
from importlib.util import find_spec

found = [name for name in ("torch", "stable_baselines3", "moral_algorithms") if find_spec(name)]
if found:
    raise SystemExit(f"the environment for moral-envs alone has {', '.join(found)}")
CHECK
echo "tests/envs with the moral-envs wheel and without torch:"
"$python" -m pytest -p no:cacheprovider "$@" tests/envs
