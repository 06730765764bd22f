# `make demo` and `make test` do everything on a fresh Debian or Ubuntu; `make help` lists the rest.
# Another interpreter: make demo PYTHON=python3.12. Arguments for pytest: make test PYTEST_ARGS="-k footprint -x".

VENV := .venv
BIN := $(VENV)/bin
PYTHON ?=
PYTEST_ARGS ?= -n auto --dist worksteal
LONG_TESTS ?= $(shell grep -rl ROBOCAR_LONG_TESTS tests --include=test_*.py)
SETUP_INPUTS := pyproject.toml constraints.txt scripts/setup.sh

export PYTHON
export MUJOCO_GL ?= egl

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help demo test test-long check format format-check lint types regression baseline bench clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 14

# One stamp for each set of extras, made anew when what is to be installed has changed.
$(VENV)/.ready-demo: $(SETUP_INPUTS)
	@bash scripts/setup.sh demo

$(VENV)/.ready-dev: $(SETUP_INPUTS)
	@bash scripts/setup.sh dev

$(VENV)/.ready-bench: $(SETUP_INPUTS)
	@bash scripts/setup.sh bench

demo: $(VENV)/.ready-demo ## drive the default scenario and say where its recording is
	@$(BIN)/robocar run thesis-field --out runs --force
	@echo
	@echo "Open the recording (a window):     $(BIN)/robocar view $$(ls -td runs/thesis-field--*/ | head -n 1)"
	@echo "The same in the web browser:       $(BIN)/robocar view $$(ls -td runs/thesis-field--*/ | head -n 1) --web"

test: $(VENV)/.ready-dev ## run all tests
	@$(BIN)/python -m pytest $(PYTEST_ARGS)

# The tests that are skipped elsewhere because they take minutes: experiments in full, ten thousand damaged files.
test-long: $(VENV)/.ready-dev ## run the long tests, and those beside them
	@ROBOCAR_LONG_TESTS=1 $(BIN)/python -m pytest $(PYTEST_ARGS) $(LONG_TESTS)

check: format-check lint types test ## all that a change has to pass: format, lint, types, tests

format: $(VENV)/.ready-dev ## format the code and mend what ruff can mend
	@$(BIN)/ruff check --fix-only --quiet .
	@$(BIN)/ruff format .

format-check: $(VENV)/.ready-dev ## is the code formatted?
	@$(BIN)/ruff format --check .

lint: $(VENV)/.ready-dev ## ruff's rules (pyproject.toml)
	@$(BIN)/ruff check .

types: $(VENV)/.ready-dev ## pyright
	@$(BIN)/pyright

# The quick suite against its baseline: fails where a navigator behaves differently, or on another machine where it is worse.
regression: $(VENV)/.ready-dev ## has any navigator changed its behaviour?
	@rm -rf runs/quick
	@$(BIN)/robocar sweep quick --out runs/quick
	@$(BIN)/robocar compare models/suites/quick.baseline.json runs/quick

baseline: $(VENV)/.ready-dev ## what the navigators do now is what they shall do: write the baseline of the quick suite anew
	@rm -rf runs/quick
	@$(BIN)/robocar sweep quick --out runs/quick
	@$(BIN)/robocar results runs/quick --baseline models/suites/quick.baseline.json

# One after the other: benchmarks must not share the processor.
bench: $(VENV)/.ready-bench ## the benchmarks and their tables
	@status=0; for file in benchmarks/bench_*.py; do \
		echo "== $$file"; \
		$(BIN)/python -m robocar.benchmarks.$$(basename $$file .py) || status=1; \
	done; exit $$status

clean: ## remove the virtual environment, caches and builds; runs/ stays
	@rm -rf $(VENV) build dist .pytest_cache .hypothesis .ruff_cache .benchmarks MUJOCO_LOG.TXT
	@find robocar planners experiments benchmarks tests -type d -name __pycache__ -prune -exec rm -rf {} +
