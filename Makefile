# All set-up, then the job. Each target says what it does and is quick when nothing is to be done.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

VENV   := .venv
BIN    := $(VENV)/bin
# The first that really runs and is new enough: a name on the path may be the shim of a version manager.
ifndef PYTHON
PYTHON := $(or $(shell for p in python3.12 python3.11 python3.13 python3; do \
  if $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then echo $$p; break; fi; done),python3)
endif
SYSTEM := swi-prolog-nox libegl1 libgl1 libx11-6 libusb-1.0-0

.PHONY: help demo test check format bench setup system clean

help:
	@echo "make demo    set everything up and run the main job: map a simulated home over Zenoh, ask questions, draw it"
	@echo "make test    set everything up and run all tests"
	@echo "make check   lint, format, types and import walls"
	@echo "make bench   benchmarks against peers"
	@echo "make format  let ruff rewrite the sources"

demo: $(VENV)/.installed
	@$(BIN)/scenegraph demo --output out/demo

test: $(VENV)/.installed-test
	@$(BIN)/python -m pytest

check: $(VENV)/.installed-test
	@echo "== ruff"; $(BIN)/ruff check . && $(BIN)/ruff format --check .
	@echo "== mypy --strict"; $(BIN)/mypy
	@echo "== import walls"; $(BIN)/lint-imports

bench: $(VENV)/.installed-test
	@$(BIN)/python -m pytest tests/benchmarks --benchmark-enable --benchmark-only --benchmark-columns=min,median,max,rounds -s

format: $(VENV)/.installed-test
	@$(BIN)/ruff check --fix . ; $(BIN)/ruff format .

# -- set-up --------------------------------------------------------------------------------------------------
setup: $(VENV)/.installed-test

system:
	@missing=""; \
	if command -v dpkg-query >/dev/null; then \
	  for p in $(SYSTEM); do dpkg-query -W -f='$${Status}' $$p 2>/dev/null | grep -q 'install ok installed' || missing="$$missing $$p"; done; \
	  "$(PYTHON)" -c 'import ensurepip, venv' 2>/dev/null || missing="$$missing python3-venv"; \
	  if [ -n "$$missing" ]; then \
	    echo "Installing system packages:$$missing"; \
	    sudo=""; [ "$$(id -u)" = 0 ] || sudo=sudo; \
	    $$sudo apt-get update -qq && $$sudo env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $$missing; \
	  fi; \
	elif ! command -v swipl >/dev/null; then \
	  echo "This system has no apt. Please install SWI-Prolog 9 and the libraries EGL, GL, X11 and libusb 1.0, then run make again."; exit 1; \
	fi
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed: set PYTHON=/path/to/python."; exit 1; }

$(VENV)/bin/pip: | system
	@echo "Creating the virtual environment in $(VENV)"
	@"$(PYTHON)" -m venv $(VENV)

$(VENV)/.installed: pyproject.toml | system $(VENV)/bin/pip
	@echo "Installing scenegraph-service and its dependencies into $(VENV) (about 0.8 GB the first time)"
	@$(BIN)/pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(VENV)/.installed-test: pyproject.toml | $(VENV)/.installed
	@echo "Installing what tests and checks need"
	@$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test,check]'
	@touch $@

clean:
	rm -rf $(VENV) out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
