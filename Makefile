# keypose: `make` lists what there is to do. Everything is set up on first use; only Python 3.11+ and make are needed.
SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CLIENT := $(shell find client -type f -not -path '*/node_modules/*' -not -path '*/dist/*' 2>/dev/null)

.DEFAULT_GOAL := help
.PHONY: help demo studio test check fast format system bench clean

help: ## list these targets
	@echo "keypose - character animation in Python"; echo
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-8s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(VENV)/.installed ## set up, then open the studio on the built-in character (ARGS="--no-browser")
	@$(BIN)/keypose demo $(ARGS)

studio: $(VENV)/.installed ## set up, then open the studio (ARGS="walk.bvh character.glb")
	@$(BIN)/keypose studio $(ARGS)

test: check system ## set up, then check everything and run all tests
	@$(BIN)/python -m pytest -n 2 --dist worksteal $(ARGS)

check: $(VENV)/.tools ## style, types, layers
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/pyright
	$(BIN)/lint-imports

fast: $(VENV)/.tools ## tests that need neither a browser nor OpenGL
	@$(BIN)/python -m pytest -n 2 --dist worksteal -m "not browser and not gl and not slow" $(ARGS)

format: $(VENV)/.tools ## format the code
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

bench: $(VENV)/.tools ## ratios against other libraries and the machine's limits
	@$(BIN)/python -m pip install -q --group bench
	@$(BIN)/keypose bench $(ARGS)

system: ## as root on Debian: install Chromium and Mesa for the tests that need them
	@bash scripts/system_packages.sh

clean: ## remove everything that was built or installed here
	rm -rf $(VENV) build dist client/node_modules src/keypose/studio/static
	find . -name __pycache__ -prune -exec rm -rf {} +

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "keypose needs Python 3.11 or newer"; exit 1; }
	@echo "making the virtual environment $(VENV)"
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(BIN)/python pyproject.toml hatch_build.py $(CLIENT)
	@echo "installing keypose and building the studio (about a minute the first time)"
	@$(BIN)/python -m pip install --disable-pip-version-check -q -e .
	@touch $@

$(VENV)/.tools: $(VENV)/.installed
	@echo "installing the test tools"
	@$(BIN)/python -m pip install --disable-pip-version-check -q -U "pip>=25.1"
	@$(BIN)/python -m pip install -q --group test --group check --group peers --group formats -e '.[compression]'
ifeq ($(TORCH),1)
	@echo "installing PyTorch for the tests of gradients"
	@$(BIN)/python -m pip install -q --group torch
endif
	@touch $@
