# make            lists the targets; the first one that needs the environment builds it in .venv
# LAW=consistent  law of the demo: consistent, projected, classic, multi_model, joint_space or module:function of one's own
# DURATION=       duration of one way in the demo, s
# CONFIG=         file of the campaign (config/campaign_small.yaml)
# ARGS=           further arguments of dextar or pytest, such as --cov of make check
# EXTRAS=         of setup.py that make setup adds: campaign, export, video
# PYTHON=python3  the interpreter that .venv is made with, 3.10 to 3.13

PYTHON ?= python3
LAW ?= consistent
DURATION ?=
CONFIG ?= config/campaign_small.yaml
EXTRAS ?=
ARGS ?=

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.ONESHELL:
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
.PHONY: help setup demo campaign check test docs interfaces bench clean set-up-test

BIN := .venv/bin
SET_UP := PYTHON="$(PYTHON)" ./set_up.sh
# Two files at a time, in processes and DDS domains of their own.
PYTEST := $(BIN)/python -m pytest -q --numprocesses=2 --dist=loadfile
COVERAGE := echo "of the mathematics' lines the unit tests run $$($(BIN)/coverage report --format=total) % ($(BIN)/coverage report lists them)"

help: ## this list
	@sed -n 's/^# \{1,2\}//p;/^$$/q' Makefile
	echo
	sed -nE 's/^([a-z]+):.*## (.*)/make \1\t\2/p' Makefile | expand -t 16

setup: ## make .venv with what the demo needs, and EXTRAS; the other targets do it by themselves
	@$(SET_UP) $(EXTRAS)

demo: ## plan, simulate, control, record and judge one crossing; result in runs/
	@$(SET_UP)
	$(BIN)/dextar demo --law $(LAW) $(if $(DURATION),--duration $(DURATION)) $(ARGS)

campaign: ## a small campaign on all cores, in about two minutes; result in runs/
	@$(SET_UP) campaign
	$(BIN)/dextar campaign $(CONFIG) $(ARGS)

# The types are checked beside the tests: each keeps about one core busy.
check: set-up-test ## formatter, linter, types, and the tests that start nothing, in a minute
	@$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy & types=$$!
	tests=0
	$(PYTEST) test/unit $(ARGS) || tests=$$?
	wait $$types
	$(if $(findstring --cov,$(ARGS)),$(COVERAGE))
	exit $$tests

test: set-up-test .venv/installed-js ## run the tests
	@$(PYTEST) --durations=10 $(ARGS)

docs: ## build the documentation into docs/_build/index.html, which opens offline
	@$(SET_UP) docs
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build
	echo "docs/_build/index.html"

interfaces: ## build the action go and the readable messages into install/ (docs/interfaces.md)
	@case "$$PWD" in
	*" "*) echo "error: colcon's setup files do not work in '$$PWD': clone into a folder without a space in its path" >&2; exit 1 ;;
	esac
	$(SET_UP) interfaces
	command -v cmake >/dev/null && command -v c++ >/dev/null || \
		{ echo "error: cmake and a C++ compiler are needed; on Debian or Ubuntu: sudo apt install cmake g++" >&2; exit 1; }
	. $(BIN)/activate
	export AMENT_PREFIX_PATH=$${AMENT_PREFIX_PATH:-$$VIRTUAL_ENV}
	CMAKE_PREFIX_PATH=$$AMENT_PREFIX_PATH python -m colcon build --base-paths interfaces \
		--cmake-args -DPython3_EXECUTABLE="$$VIRTUAL_ENV/bin/python" -DCMAKE_PROJECT_INCLUDE="$$PWD/interfaces/on_wheels.cmake"

bench: ## measure the loop on this machine
	@$(SET_UP)
	$(BIN)/dextar bench $(ARGS)

clean: ## remove .venv, builds and caches; recordings in runs/ stay
	@rm -rf .venv build docs/_build install log *.egg-info .pytest_cache .hypothesis .mypy_cache .ruff_cache .coverage*
	find . -name .git -prune -o -name __pycache__ -type d -print0 | xargs -0 rm -rf

set-up-test:
	@$(SET_UP) campaign docs export video interfaces test check oracle

# The test with Foxglove's own readers is skipped where these cannot be installed.
.venv/installed-js: test/tools/js/package.json | set-up-test
	@command -v node >/dev/null && command -v npm >/dev/null || \
		{ echo "no Node.js with npm here: the test with Foxglove's readers is skipped"; exit 0; }
	echo "installing Foxglove's readers for a test (npm)"
	mkdir -p .venv/js
	cp test/tools/js/package.json .venv/js/
	cd .venv/js
	npm install --no-audit --no-fund --no-update-notifier --loglevel=error >/dev/null || \
		{ echo "npm could not install them: that test is skipped"; exit 0; }
	touch ../installed-js
