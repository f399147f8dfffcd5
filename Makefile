# Everything runs from a fresh clone: the first target that needs it makes the virtual environment.
#   make test VENV=/some/where/else       another place for it
#   make test TORCH='torch==2.13.0 ...'   another build of PyTorch (extra pip arguments are passed on)
SHELL := /bin/bash

VENV ?= .venv
PYTHON ?= python3
TORCH ?= torch==2.13.0
PYTEST_WORKERS ?= 2
FUZZ_CASES ?= 200
SEED ?= 0

BIN := $(VENV)/bin
STAMP := $(VENV)/.saver-installed
CLUSTER_STAMP := $(VENV)/.saver-cluster-installed

# Off-screen rendering through EGL on Linux, unless the caller says otherwise.
ifeq ($(shell uname -s),Linux)
export MUJOCO_GL ?= egl
endif
# One thread of linear algebra a process: more of them beside a busy simulator are slower.
export OMP_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.PHONY: help install demo test test-long fuzz mutants lint format docs wheel release rendering clean distclean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 14

install: $(STAMP)  ## make or update the virtual environment

# PyTorch goes first and by exact version, so that nothing below asks for a newer build of it.
$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "SAVER needs Python 3.11 or newer; say which with: make PYTHON=python3.12 ..." >&2; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) \
	  || { echo "Could not make $(VENV). On Debian or Ubuntu: apt-get install python3-venv" >&2; exit 1; }
	$(BIN)/python -m pip install --quiet $(TORCH)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[train,logging,datasets,view,modelling,pose,pose-tools,integration,docs,dev]'
	@touch $@

# The long tests start a cluster of two nodes.
$(CLUSTER_STAMP): $(STAMP)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[cluster]'
	@touch $@

# Finds EGL, or installs it where that is allowed, or says what to install.
rendering:
	@tools/ensure_egl.sh

demo: $(STAMP) rendering  ## play the shipped policies, learn for two minutes, leave demo_output/
	$(BIN)/saver demo --output demo_output

test: lint rendering  ## lint, types and tests, within ten minutes
	$(BIN)/python -m pytest -n $(PYTEST_WORKERS) -m "not long" --durations=10 --junitxml=.reports/test.xml

test-long: $(CLUSTER_STAMP) rendering  ## the tests that take longer
	$(BIN)/python -m pytest -m long --durations=0 --junitxml=.reports/test-long.xml

fuzz: $(STAMP)  ## thousands of bad inputs: FUZZ_CASES for each test, drawn by SEED
	FUZZ_CASES=$(FUZZ_CASES) $(BIN)/python -m pytest tests/fuzz --hypothesis-seed=$(SEED) \
	  -o faulthandler_timeout=120 -o faulthandler_exit_on_timeout=true

mutants: $(STAMP)  ## 200 faults made in the code, drawn by SEED: how many do the tests notice?
	$(BIN)/python tools/mutants.py --seed $(SEED) --workers $(PYTEST_WORKERS) --coverage .mutants

lint: $(STAMP)  ## ruff and mypy, nothing is changed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(STAMP)  ## put imports and layout in order
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(STAMP) rendering  ## regenerate the pages that come from code, then build site/
	$(BIN)/python -m reproduction pages
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

wheel: $(STAMP)  ## build the sdist and the wheel into dist/
	$(BIN)/python -m build

release: $(STAMP)  ## the checklist of a release; builds dist/
	$(BIN)/python tools/release.py

clean:  ## remove what the other targets made, but for the virtual environment
	rm -rf build dist site demo_output *.egg-info .mutants .reports .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find saver_envs saver_advisors reproduction tests -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean  ## and the virtual environment .venv
	rm -rf .venv
