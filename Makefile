# The doors of the project. Each does its own set-up in .venv, once; all that a machine needs is Python 3.11 or newer.

PYTHON := .venv/bin/python
OPTIONS := --numprocesses auto --maxprocesses 8 --dist worksteal
PYTEST := $(PYTHON) -m pytest $(OPTIONS)
# Without bytecode on disk every worker, and every process that a test starts, would compile the same modules again.
export PYTHONDONTWRITEBYTECODE :=

# Tests that run on other versions too: the compiler and its cache, arms and environments; agents that are loaded and trained.
OF_CORE := tests/compiler tests/scene \
	tests/mechanics/algebra $(addprefix tests/envs/test_,gymnasium.py registration.py rewards.py actuation.py) \
	$(addprefix tests/control/test_,dynamics.py predictive.py tip_tracking.py)
OF_AGENTS := tests/policies tests/export $(addprefix tests/learning/test_,train.py vec_env.py)
# A Python 3.x that runs: `$(call python,11)`; on the PATH, or one of pyenv's.
python = $(shell for found in python3.$(1) $(wildcard $(HOME)/.pyenv/versions/3.$(1).*/bin/python); do $$found -c '' 2>/dev/null && echo $$found && break; done)
OLDEST = $(firstword $(foreach minor,11 12 13 14,$(call python,$(minor))))
NEWEST = $(firstword $(foreach minor,14 13 12 11,$(call python,$(minor))))

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help demo test test-all test-no-jit test-lowest test-newest check bench peers rllib docs tables dist clean

help: ## list the doors
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-11s  %s\n", $$1, $$2 }' Makefile

demo: .venv/.installed-demo ## controllers and agents that ship side by side on the paper's arm: a table, a picture, a recording
	$(PYTHON) -m soft_tendon_env demo
	@du -sh .venv

test: .venv/.installed-test ## run the tests, but those that take long
	$(PYTEST) -m "not slow"

test-all: test ## run the tests, then those that take long
	$(PYTEST) -m slow

test-no-jit: .venv/.installed-test ## tests with interpreted kernels: numpy checks the bounds of every index that compiled code does not
	NUMBA_DISABLE_JIT=1 $(PYTEST) tests -m "no_jit and not slow"

test-lowest: .venv-lowest/.installed ## tests that hang on versions, with the lowest of all that are allowed, on the oldest Python, in .venv-lowest
	.venv-lowest/bin/python -m pytest $(OPTIONS) -m "not slow" $(OF_CORE) $(OF_AGENTS)

test-newest: .venv-newest/.installed ## such tests without agents, on the newest Python that is there, with the newest versions, in .venv-newest
	.venv-newest/bin/python -m pytest $(OPTIONS) -m "not slow" $(OF_CORE)

check: .venv/.installed-check ## lint, format, types, direction of imports
	$(PYTHON) -m ruff check
	$(PYTHON) -m ruff format --check
	$(PYTHON) -m mypy
	.venv/bin/lint-imports

bench: .venv/.installed-bench ## measure accuracy and speed: a table, a CSV file and a picture each
	@set -e; for benchmark in $(filter-out benchmarks/peers.py,$(wildcard benchmarks/[a-z]*.py)); do echo "$(PYTHON) $$benchmark"; $(PYTHON) "$$benchmark"; done

peers: .venv-peers/.installed ## measure beside MuJoCo, PyElastica and SoRoMoX, in .venv-peers: tables and a picture in out/
	.venv-peers/bin/python benchmarks/peers.py

rllib: .venv-rllib/.installed ## an environment with Ray and RLlib, .venv-rllib, and the tests that need it
	.venv-rllib/bin/python -m pytest tests/learning/test_rllib.py tests/tools/test_parallel.py

docs: .venv/.installed-docs ## build the documentation into site/; every warning is an error
	NO_MKDOCS_2_WARNING=1 $(PYTHON) -m mkdocs build --quiet
	@echo "written: site/index.html; to search in it: python3 -m http.server --directory site"

tables: .venv/.installed-bench .venv/.installed-test ## make the tables and pictures of the documentation anew where code has changed since; goes on after a stop
	$(PYTHON) docs/generated.py

dist: .venv/.installed-dist ## build the wheel and the source distribution into dist/, and check them
	rm -rf dist
	$(PYTHON) -m build --outdir dist .
	$(PYTHON) -m twine check --strict dist/*
	@echo "to install: pip install dist/soft_tendon_env-*.whl"

clean: ## remove .venv and what the tools left behind
	rm -rf .venv .venv-lowest .venv-newest .venv-peers .venv-rllib dist site .mypy_cache .pytest_cache .ruff_cache .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamp says that the package and one of its extras are installed as pyproject.toml and constraints.txt have them now.
.venv/.installed-%: pyproject.toml constraints.txt | $(PYTHON)
	@echo "Installing soft_tendon_env[$*] into .venv; this takes a while the first time."
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check --no-input -c constraints.txt --editable '.[$*]'
	@touch $@

# The other simulators have an environment of their own, which is made with the Python of .venv.
.venv-peers/.installed: pyproject.toml constraints-peers.txt | $(PYTHON)
	@echo "Installing soft_tendon_env[peers] into .venv-peers; this takes a while the first time."
	@$(PYTHON) -m venv .venv-peers
	@.venv-peers/bin/python -m pip install --quiet --disable-pip-version-check --no-input -c constraints-peers.txt --editable '.[peers]'
	@touch $@

.venv-lowest/.installed: pyproject.toml constraints-lowest.txt
	@echo "Installing the lowest versions into .venv-lowest with $(OLDEST); this takes a while the first time."
	@$(OLDEST) -m venv --clear .venv-lowest
	@.venv-lowest/bin/python -m pip install --quiet --disable-pip-version-check --no-input -c constraints-lowest.txt --editable '.[test]'
	@touch $@

# Without agents: torch comes for some Pythons with gigabytes of GPU libraries.
.venv-newest/.installed: pyproject.toml
	@echo "Installing the newest versions into .venv-newest with $(NEWEST); this takes a while the first time."
	@$(NEWEST) -m venv --clear .venv-newest
	@.venv-newest/bin/python -m pip install --quiet --disable-pip-version-check --no-input --editable '.[testing]'
	@touch $@

# RLlib holds Gymnasium at a version of its own.
.venv-rllib/.installed: pyproject.toml constraints.txt | $(PYTHON)
	@echo "Installing soft_tendon_env[rllib] into .venv-rllib; this takes a while the first time."
	@$(PYTHON) -m venv .venv-rllib
	@.venv-rllib/bin/python -m pip install --quiet --disable-pip-version-check --no-input -c constraints.txt \
		--editable '.[rllib]' pytest pytest-timeout
	@touch $@

$(PYTHON):
	@found=; \
	for candidate in python3 python3.14 python3.13 python3.12 python3.11; do \
		if $$candidate -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then found=$$candidate; break; fi; \
	done; \
	if [ -z "$$found" ]; then echo "soft_tendon_env needs Python 3.11 or newer; there is none on the PATH." >&2; exit 1; fi; \
	if ! $$found -c 'import venv, ensurepip' 2>/dev/null; then \
		echo "$$found cannot create virtual environments: install its venv module (on Debian and Ubuntu, the package python3-venv)." >&2; exit 1; \
	fi; \
	$$found -m venv .venv || { rm -rf .venv; exit 1; }
