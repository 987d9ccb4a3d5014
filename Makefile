.DEFAULT_GOAL := help
.PHONY: help setup setup-test demo test lint types unit clean

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

help:  ## what each target does
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 14

demo: setup  ## annotate the bundled objects into runs/demo and show what came out
	$(BIN)/gmdx generate bundled --out runs/demo
	$(BIN)/gmdx inspect runs/demo

test: lint types unit  ## everything that CI runs

setup: $(VENV)/.installed
setup-test: $(VENV)/.installed-test

$(VENV)/.installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "gmdx needs Python 3.11 or newer; pass PYTHON=/path/to/python")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	@touch $@

$(VENV)/.installed-test: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[test]'
	@touch $@

lint: setup-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup-test
	$(BIN)/mypy

unit: setup-test
	$(BIN)/python -m pytest -n 2

clean:  ## remove the environment and what the demo made
	rm -rf $(VENV) runs/demo
