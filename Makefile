# Every target sets up what it needs first; `make` alone lists them.
# PYTHON=/path/to/python3.11 chooses the interpreter, RENDER=no goes without Vulkan and pictures,
# JOBS=4 runs the tests in so many processes.
SHELL := /bin/bash
BIN := .venv/bin
RENDER ?= yes
export PYTHON RENDER
# Without kept bytecode each process of the tests compiles them, and the package, again.
unexport PYTHONDONTWRITEBYTECODE

# The set-up is done again only when what it depends on has changed.
STAMP := .venv/.setup-$(shell (echo "$(CURDIR) $(RENDER)"; cat pyproject.toml scripts/setup.sh) | sha256sum | cut -c1-16)
# Policies learn from pictures: without them the demo ends with the demonstrations.
DEMO := $(if $(filter no,$(RENDER)),render=false stages=[generate])
# Each process keeps to one core.
JOBS ?= 2
TESTS := OMP_NUM_THREADS=1 LP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(JOBS) --dist loadscope --no-loadscope-reorder
PICTURED_TESTS := $(if $(filter no,$(RENDER)),-m "not render")

.DEFAULT_GOAL := help
.PHONY: help setup demo gallery site test check format lint types imports fast-tests fix doctor bench clean

help: ## this list
	@sed -nE 's/^([a-z-]+):.*## (.*)/  make \1\t\2/p' Makefile | expand -t 20

setup: $(STAMP) ## virtual environment, packages and, where missing, software Vulkan
	@:

$(STAMP):
	@scripts/setup.sh
	@rm -f .venv/.setup-*; touch $@

demo: setup ## lift_barrier from demonstrations to report, on a laptop
	$(BIN)/python -m rf_exp.run $(DEMO)

gallery: setup ## what every task looks like: a contact sheet and a film of each
	$(BIN)/python -m rf_exp.gallery task=all

# A notice of the theme's authors is no warning.
site: setup ## the documents, and pages of the interfaces, as a site: build/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict -q

test: setup ## every test, pictures included
	$(TESTS) $(PICTURED_TESTS) --durations=25 --durations-min=10

check: format lint imports site ## the gate before a commit, in 90 seconds on two cores
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

fix: setup ## let ruff format and fix what it can
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

doctor: ## what this machine can do, and how to fix what it cannot
	@$$([ -x $(BIN)/python ] && echo $(BIN)/python || echo $${PYTHON:-python3}) -m rf_exp.doctor

bench: setup ## every figure that the documents claim
	@set -e; for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python "$$script"; done

clean: ## remove the environment and caches; outputs/ stays
	rm -rf .venv build *.egg-info .pytest_cache .hypothesis .ruff_cache .import_linter_cache
	find rf_exp tests benchmarks examples -name __pycache__ -prune -exec rm -rf {} +
