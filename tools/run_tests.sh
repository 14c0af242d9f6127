#!/usr/bin/env bash
# Runs all tests: those of moral-envs with its wheel alone, in one process, while PyTorch is installed and beside
# the first of the others. What is said of them comes at the end. Arguments go to pytest. Run by `make test`.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

said=$(mktemp)
# In a process group of its own, so that it can be ended with all that it has started.
set -m
tools/check_envs_alone.sh "$@" -n 0 >"$said" 2>&1 &
alone=$!
set +m
trap 'kill -- "-$alone" 2>/dev/null || true; rm -f "$said"' EXIT
trap 'exit 130' INT TERM

failed=0
make --no-print-directory .venv/.dev
.venv/bin/python -m pytest "$@" --ignore tests/envs || failed=1
wait "$alone" || failed=1
cat "$said"
exit "$failed"
