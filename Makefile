# noiseid: set-up and common tasks. `make help` lists the targets.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
BENCH := .bench
LETTERS ?= abcdefg
READY := $(VENV)/.ready
JOBS ?= 2
FUZZ_EXAMPLES ?= 4000
FUZZ_SEED ?= 0
CONFIG ?= noiseid_cli/config/quickstart.yaml
RUNS ?= runs

.DEFAULT_GOAL := help
.PHONY: help setup demo run simulate import estimate report test test-browser fuzz lint format bench validation clean

help: ## List the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  %-13s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(READY) ## Make .venv with everything pinned in constraints.txt
$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit("noiseid needs Python 3.11 or newer") if sys.version_info < (3, 11) else None'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $@

demo: $(READY) ## Main job on the flexible robot: simulate, estimate by EM, report
	$(BIN)/noiseid run $(CONFIG) --jobs $(JOBS) --out $(RUNS)

run: demo ## The same as demo; CONFIG=file takes another experiment

simulate: $(READY) ## Simulate the datasets of CONFIG
	$(BIN)/noiseid simulate $(CONFIG) --jobs $(JOBS) --out $(RUNS)

import: $(READY) ## Import the recordings of CONFIG
	$(BIN)/noiseid import $(CONFIG) --jobs $(JOBS) --out $(RUNS)

estimate: $(READY) ## Run the methods of CONFIG on its datasets
	$(BIN)/noiseid estimate $(CONFIG) --jobs $(JOBS) --out $(RUNS)

report: $(READY) ## Make the report of CONFIG from its results
	$(BIN)/noiseid report $(CONFIG) --out $(RUNS)

test: $(READY) ## Run the tests
	$(BIN)/python -m pytest

test-browser: $(READY) ## Open the report in headless Chromium, where there is one
	$(BIN)/python -m pytest -m browser tests/browser

fuzz: $(READY) ## Hostile experiments, models, logs and files, about 15 minutes (FUZZ_EXAMPLES, FUZZ_SEED)
	@FUZZ_EXAMPLES=$(FUZZ_EXAMPLES) FUZZ_SEED=$(FUZZ_SEED) $(BIN)/python tests/fuzz.py

lint: $(READY) ## Check style, types and the import floors
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(READY) ## Bring the code into the project's format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(BENCH)/.ready ## Time noiseid and its peers (LETTERS=ab: some of a to g; WRITE=1: tables to README and docs)
	OPENBLAS_NUM_THREADS=1 $(BENCH)/bin/python benchmarks/run.py $(LETTERS) $(if $(WRITE),--write)

$(BENCH)/.ready: pyproject.toml constraints.txt benchmarks/requirements.txt
	$(PYTHON) -m venv $(BENCH)
	$(BENCH)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable .
	@grep -v '^#' benchmarks/requirements.txt | while read -r peer; do \
	  $(BENCH)/bin/python -m pip install --quiet --disable-pip-version-check "$$peer" \
	  || echo "$$peer cannot be installed here: its rows will say so"; done
	@touch $@

validation: $(READY) ## Statistical claims as experiments: bias, coverage and efficiency in one table
	@$(BIN)/python benchmarks/validation.py $(RUNS) $(JOBS)

clean: ## Remove .venv, caches and runs
	rm -rf $(VENV) $(BENCH) $(RUNS) .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
