#!/usr/bin/env bash
# What a user of the environments alone gets: the moral-envs wheel in a virtual environment without torch.
#
#   tools/envs_alone.sh install       make .venv/alone, with what the wheel asks for and what its tests need
#   tools/envs_alone.sh test [ARGS]   install the wheel as it is now and run tests/envs; ARGS go to pytest
#
# `make test` does both, one after the other. It has made .venv; PIP_ARGS goes to pip.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

python=.venv/alone/bin/python
wheels=$(mktemp -d)
trap 'rm -rf "$wheels"' EXIT
pip() { .venv/bin/python -m pip --disable-pip-version-check --quiet "$@"; }
# shellcheck disable=SC2086  # PIP_ARGS holds several words
install() { pip --python "$python" install --no-compile -c constraints.txt ${PIP_ARGS:-} "$@"; }
install_wheel() {
  pip wheel --no-deps --no-build-isolation --wheel-dir "$wheels" ./envs
  install "$@" "$wheels"/moral_envs-*.whl
}

case ${1:-} in
  install)
    .venv/bin/python -m venv --clear --without-pip .venv/alone
    install_wheel
    "$python" -c 'import moral_envs'   # its declared dependencies suffice
    install --group test-envs
    install --no-deps --group peers
    ;;
  test)
    shift
    install_wheel --no-deps --force-reinstall
    "$python" - <<'CHECK'
from importlib.util import find_spec

found = [name for name in ("torch", "stable_baselines3", "moral_algorithms") if find_spec(name)]
if found:
    raise SystemExit(f"the environment for moral-envs alone has {', '.join(found)}")
CHECK
    echo "tests/envs with the moral-envs wheel and without torch:"
    "$python" -m pytest -p no:cacheprovider "$@" tests/envs
    ;;
  *)
    echo "usage: tools/envs_alone.sh install | test [ARGS]" >&2
    exit 2
    ;;
esac
