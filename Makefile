# `make` lists the targets; each runs the set-up first if it needs it.
# PYTHON=/path/to/python3.11: interpreter; RENDER=no: without Vulkan and pictures; JOBS=4: number of test processes.
SHELL := /bin/bash
BIN := .venv/bin
RENDER ?= yes
export PYTHON RENDER
# Without cached bytecode each test process would compile tests and package again.
unexport PYTHONDONTWRITEBYTECODE

# The set-up runs again only when its inputs have changed.
STAMP := .venv/.setup-$(shell (echo "$(CURDIR) $(RENDER)"; cat pyproject.toml scripts/setup.sh) | sha256sum | cut -c1-16)
# Policies are trained on pictures: without them the demo ends with the demonstrations.
DEMO := $(if $(filter no,$(RENDER)),render=false stages=[generate])
# Each test process uses one core.
JOBS ?= 2
TESTS := OMP_NUM_THREADS=1 LP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(JOBS) --dist loadscope --no-loadscope-reorder
PICTURED_TESTS := $(if $(filter no,$(RENDER)),-m "not render")

.DEFAULT_GOAL := help
.PHONY: help setup demo gallery site test check format lint types imports fast-tests fix doctor bench clean

help: ## list the targets
	@sed -nE 's/^([a-z-]+):.*## (.*)/  make \1\t\2/p' Makefile | expand -t 20

setup: $(STAMP) ## install virtual environment, packages and, if missing, software Vulkan
	@:

$(STAMP):
	@scripts/setup.sh
	@rm -f .venv/.setup-*; touch $@

demo: setup ## run lift_barrier from demonstrations to report, on a laptop
	$(BIN)/python -m rf_exp.run $(DEMO)

gallery: setup ## render every task: a contact sheet, and a film of each
	$(BIN)/python -m rf_exp.gallery task=all

# The notice of the theme's authors would count as a warning.
site: setup ## build the documentation, with API reference: build/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict -q

test: setup ## run all tests, including those that render
	$(TESTS) $(PICTURED_TESTS) --durations=25 --durations-min=10

check: format lint imports site ## run the checks before a commit, 90 seconds on two cores
	@$(MAKE) --no-print-directory -j 2 --output-sync=target types fast-tests

format: setup
	$(BIN)/ruff format --check .

lint: setup
	$(BIN)/ruff check .

types: setup
	$(BIN)/pyright

imports: setup
	$(BIN)/lint-imports

fast-tests: setup
	$(TESTS) -q -m "not render and not slow" --durations=10 --durations-min=3

fix: setup ## format the code and fix lint errors with ruff
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

doctor: ## diagnose this machine: what works, and how to fix the rest
	@$$([ -x $(BIN)/python ] && echo $(BIN)/python || echo $${PYTHON:-python3}) -m rf_exp.doctor

bench: setup ## run all benchmarks behind the figures in the documents
	@set -e; for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python "$$script"; done

clean: ## remove virtual environment and caches; outputs/ is kept
	rm -rf .venv build *.egg-info .pytest_cache .hypothesis .ruff_cache .import_linter_cache
	find rf_exp tests benchmarks examples -name __pycache__ -prune -exec rm -rf {} +
