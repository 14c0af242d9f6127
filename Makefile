# Every target makes .venv and installs what it needs, once; see `make help`.

PYTHON ?= python3
# Passed to every pip install: an index with CPU-only builds of PyTorch, for example (see pytorch.org).
PIP_ARGS ?=
PYTEST_ARGS ?= -n 3 --dist worksteal
DEMO_ARGS ?=
LIVE_ARGS ?= --rewards runs/demo/airl --out runs/live

VENV := .venv
BIN := $(VENV)/bin
# Modules are compiled on first import: of PyTorch's, most never are.
PIP_INSTALL := $(BIN)/python -m pip install --disable-pip-version-check --quiet --no-compile -c constraints.txt $(PIP_ARGS)
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo live test test-workspace test-envs-alone lint smoke bench strangers docs require-python-3.11 clean
.DELETE_ON_ERROR:

help:
	@echo "make demo    train MORAL in the Emergency world and show the result"
	@echo "make live    the demo's agent once more, with you as the teacher: answer on a page (after make demo)"
	@echo "make test    run all tests, those of moral-envs with its wheel alone, where there is no PyTorch"
	@echo "make lint    check style, types and the direction of imports"
	@echo "make smoke   every benchmark at its smallest, and the report: runs/smoke/report/index.html (a few minutes)"
	@echo "make bench   speed of the worlds, accuracy of the posterior, the demo over five seeds (about ten minutes)"
	@echo "make strangers   peers' learners on moral-envs, and its speed beside theirs (about half an hour)"
	@echo "make docs    build the site: site/index.html (needs Python 3.11 or newer)"
	@echo "make clean   remove .venv, the site and the tools' caches"
	@echo "Variables: PYTHON (3.10 or newer, now $(PYTHON)), PIP_ARGS, DEMO_ARGS, LIVE_ARGS, PYTEST_ARGS."

demo: $(VENV)/.runtime
	$(BIN)/moral demo $(DEMO_ARGS)

live: $(VENV)/.live
	$(BIN)/moral live $(LIVE_ARGS)

# Both kinds of tests side by side, for their installing takes one core; what is told of the second comes when it
# has ended. One thread per worker; three workers on two cores, since many a test waits for a process or a page.
test: export OMP_NUM_THREADS := 1
test:
	@$(MAKE) --no-print-directory -j 2 test-workspace test-envs-alone

test-workspace: $(VENV)/.test
	$(BIN)/python -m pytest $(PYTEST_ARGS) --ignore tests/envs

test-envs-alone: $(VENV)/.alone
	@PIP_ARGS="$(PIP_ARGS)" tools/envs_alone.sh test $(PYTEST_ARGS) > $(VENV)/alone.log 2>&1; status=$$?; \
	  cat $(VENV)/alone.log; exit $$status

lint: $(VENV)/.lint
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

# Two runs at a time, all from the start.
smoke: $(VENV)/.benchmarks
	rm -rf runs/smoke
	$(BIN)/python -m benchmarks run all --profile smoke --jobs 2 --out runs/smoke
	$(BIN)/python -m benchmarks report --profile smoke --out runs/smoke

bench: $(VENV)/.runtime
	$(BIN)/python -m benchmarks.engine_speed
	$(BIN)/python -m benchmarks.posterior_accuracy
	$(BIN)/python -m benchmarks.emergency_seeds

strangers:
	PYTHON="$(PYTHON)" PIP_ARGS="$(PIP_ARGS)" benchmarks/strangers/run.sh

# -W: what Sphinx warns of, a dead link for example, fails the build.
docs: require-python-3.11 $(VENV)/.docs
	rm -rf site
	$(BIN)/python -m sphinx -W --keep-going -q -E -d $(VENV)/doctrees -b html docs site
	@echo "The site: site/index.html"

require-python-3.11: $(VENV)/.created
	@$(BIN)/python -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "the site needs Python 3.11 or newer: make clean, then make docs PYTHON=/path/to/python3" >&2; exit 1; }

clean:
	rm -rf $(VENV) site .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache

$(VENV)/.created:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null || { \
	  echo "PYTHON=$(PYTHON) is not Python 3.10 or newer; name one: make PYTHON=/path/to/python3" >&2; exit 1; }
	$(PYTHON) -m venv --clear $(VENV)
	@touch $@

# Without build isolation the backend has the version that constraints.txt pins, and is installed once.
$(VENV)/.build: $(VENV)/.created constraints.txt pyproject.toml
	@$(PIP_INSTALL) pip
	@$(PIP_INSTALL) --group build
	@touch $@

$(VENV)/.runtime: $(VENV)/.build envs/pyproject.toml algorithms/pyproject.toml
	@echo "Installing moral-envs, moral-algorithms and what they need into $(VENV): PyTorch may take minutes"
	@$(PIP_INSTALL) --no-build-isolation -e envs -e algorithms
	@touch $@

$(VENV)/.alone: $(VENV)/.build envs/pyproject.toml tools/envs_alone.sh
	@PIP_ARGS="$(PIP_ARGS)" tools/envs_alone.sh install
	@touch $@

$(VENV)/.live: $(VENV)/.runtime
	@$(PIP_INSTALL) --no-build-isolation -e "algorithms[live]"
	@touch $@

$(VENV)/.benchmarks: $(VENV)/.runtime
	@echo "Installing what the benchmarks need into $(VENV)"
	@$(PIP_INSTALL) --group benchmarks
	@touch $@

# The tests start several processes at once, each of which would compile what they import: done once, beside pip.
$(VENV)/.test: $(VENV)/.runtime
	@echo "Installing what the tests need into $(VENV)"
	@$(BIN)/python -c "import matplotlib.pyplot, moral_algorithms.indicators, moral_algorithms.pipeline" & \
	  $(PIP_INSTALL) --group test && $(PIP_INSTALL) --no-deps --group peers && wait
	@touch $@

# mypy reads the tests as well.
$(VENV)/.lint: $(VENV)/.test
	@echo "Installing what checks style and types into $(VENV)"
	@$(PIP_INSTALL) --group lint
	@touch $@

$(VENV)/.docs: $(VENV)/.runtime
	@echo "Installing Sphinx into $(VENV)"
	@$(PIP_INSTALL) --group docs
	@touch $@
