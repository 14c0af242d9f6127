#!/usr/bin/env bash
# Runs the strangers, or those that are named: benchmarks/strangers/run.sh [--install] [speed] [envelope] ...
# Each trains on the moral-envs wheel of the last commit, in a virtual environment that has nothing else of this
# repository: .venv/strangers, made when it is missing or with --install. PYTHON is Python 3.11 or newer, which
# Minigrid asks for; PIP_ARGS goes to pip, for an index with CPU builds of PyTorch.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
here=benchmarks/strangers
venv=.venv/strangers

fresh=
if [[ "${1:-}" == --install ]]; then fresh=yes; shift; fi
if [[ -n "$fresh" || ! -e "$venv/.installed" ]]; then
  build=$(mktemp -d)
  trap 'rm -rf "$build"' EXIT
  "${PYTHON:-python3}" -m venv --clear "$venv"
  # shellcheck disable=SC2086  # PIP_ARGS holds several words
  pip() { "$venv/bin/python" -m pip --disable-pip-version-check --quiet "$@"; }
  install() { pip install --no-compile -c "$here/constraints.txt" ${PIP_ARGS:-} "$@"; }
  install pip
  install -r "$here/requirements.txt"
  # Of what these declare, their parts that are used here need no more than the line above brings.
  install --no-deps morl-baselines mo-gymnasium momaland imitation
  git archive HEAD envs | tar -x -C "$build"
  pip wheel --no-deps --no-build-isolation --wheel-dir "$build" "$build/envs"
  pip install --no-deps "$build"/moral_envs-*.whl
  touch "$venv/.installed"
fi

# The wheel, not the sources beside it; one thread; no account at wandb.
unset PYTHONPATH
export OMP_NUM_THREADS=1 WANDB_MODE=disabled
if [[ $# -eq 0 ]]; then
  set -- speed sb3_linear_reward mo_gymnasium_chain momaland_chain envelope imitation_airl imitation_preferences
fi
for stranger in "$@"; do
  echo "== $stranger"
  "$venv/bin/python" -m "benchmarks.strangers.$stranger"
done
