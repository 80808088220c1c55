# make            lists the targets; the first one that needs the environment builds it in .venv
# LAW=consistent  law of the demo: consistent, projected or classic
# DURATION=       duration of one way in the demo, s
# CONFIG=         file of the campaign (config/campaign_small.yaml)
# ARGS=           further arguments of dextar or pytest
# PYTHON=python3  the interpreter that .venv is made with, 3.10 to 3.13

PYTHON ?= python3
LAW ?= consistent
DURATION ?=
CONFIG ?= config/campaign_small.yaml
ARGS ?=

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.ONESHELL:
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
.PHONY: help setup demo campaign test bench lint clean FORCE

BIN := .venv/bin
PIP = $(BIN)/python -m pip install --disable-pip-version-check --no-input --progress-bar off $(CONSTRAINT)

# Of pip's output: the large downloads and what it compiles. Its errors come on stderr, untouched.
TRIM := sed -unE \
	-e 's/^ *(Downloading|Using cached) ([^ ]*\/)?([^ \/]+-[^ \/]+)\.whl.*\(([0-9.]+ [MG]B)\).*/  \3  \4/p' \
	-e 's/^ *(Building wheel for [^ ]+).*/  \1/p' -e 's/^(Installing collected packages).*/  installing/p'

# Two kinds of environment: on top of a sourced Jazzy installation, or with ROS 2 from wheels.
ifeq ($(ROS_DISTRO),)
KIND := wheels
else ifneq ($(ROS_DISTRO),jazzy)
KIND := other
else ifeq ($(shell $(PYTHON) -c 'import rclpy' 2>/dev/null && echo yes),yes)
KIND := jazzy
else ifneq ($(AMENT_PREFIX_PATH),)
KIND := unusable
else
KIND := wheels
endif

ifeq ($(KIND),jazzy)
# Jazzy's compiled messages need the numpy they were built with.
VENV_OPTIONS := --system-site-packages
CONSTRAINT := --constraint .venv/constraints.txt
EXTRAS :=
TEST_EXTRAS := [test,video]
else
EXTRAS := [ros]
TEST_EXTRAS := [ros,test,oracle,video]
endif

# An environment of the other kind, or of another folder (a copied checkout), is made anew.
export VENV_KEY := $(KIND) $(CURDIR)
ifneq ($(shell cat .venv/made-for 2>/dev/null),$(VENV_KEY))
.venv/made-for: FORCE
endif

help: ## this list
	@sed -n 's/^# \{1,2\}//p;/^$$/q' Makefile
	echo
	sed -nE 's/^([a-z]+):.*## (.*)/make \1\t\2/p' Makefile | expand -t 16

setup: .venv/warm ## make .venv with everything the demo needs; the other targets do it by themselves

demo: .venv/warm ## plan, simulate, control, record and judge one crossing; result in runs/
	@$(BIN)/dextar demo --law $(LAW) $(if $(DURATION),--duration $(DURATION)) $(ARGS)

campaign: .venv/warm ## a small campaign on all cores, in about two minutes; result in runs/
	@$(BIN)/dextar campaign $(CONFIG) $(ARGS)

test: .venv/installed-test .venv/installed-js .venv/warm ## run the tests
	@$(BIN)/python -m pytest -q --durations=10 $(ARGS)

bench: .venv/warm ## measure the loop on this machine
	@$(BIN)/dextar bench $(ARGS)

lint: .venv/installed-lint ## ruff and mypy
	@$(BIN)/ruff check .
	$(BIN)/mypy

clean: ## remove .venv, builds and caches; recordings in runs/ stay
	@rm -rf .venv build install log *.egg-info .pytest_cache .hypothesis .mypy_cache .ruff_cache
	find . -name .git -prune -o -name __pycache__ -type d -print0 | xargs -0 rm -rf

.venv/made-for:
	@fail() { echo "error: $$*" >&2; exit 1; }
	case "$(KIND)" in
	other) fail "ROS_DISTRO is '$(ROS_DISTRO)'; this package is for jazzy. Source Jazzy, or run in a shell" \
		"without ROS (ROS 2 then comes from PyPI).";;
	unusable) fail "Jazzy is sourced, but '$(PYTHON)' cannot import its rclpy. Name the interpreter it was built" \
		"for (make PYTHON=/usr/bin/python3 ...), or run in a shell without ROS.";;
	esac
	command -v "$(PYTHON)" >/dev/null || fail "there is no '$(PYTHON)'. Install Python 3.10 to 3.13, or name it:" \
		"make PYTHON=python3.12 ..."
	version=$$("$(PYTHON)" -c 'import sys; print("%d.%d" % sys.version_info[:2])') || \
		fail "'$(PYTHON)' does not start. Name another: make PYTHON=python3.12 ..."
	case "$$version" in
	3.10|3.11|3.12|3.13) ;;
	*) fail "'$(PYTHON)' is Python $$version; this package runs on 3.10 to 3.13. Name one:" \
		"make PYTHON=python3.12 ...";;
	esac
	"$(PYTHON)" -c 'import venv, ensurepip' 2>/dev/null || \
		fail "Python $$version has no venv module here. On Debian or Ubuntu: sudo apt install python$$version-venv"
	echo "making .venv with Python $$version ($(if $(filter jazzy,$(KIND)),on the sourced Jazzy,ROS 2 from PyPI))"
	"$(PYTHON)" -m venv --clear $(VENV_OPTIONS) .venv
	"$(PYTHON)" -c 'import numpy; print("numpy==" + numpy.__version__)' >.venv/constraints.txt 2>/dev/null || true
	printf '%s\n' "$$VENV_KEY" >$@

.venv/installed: .venv/made-for setup.py setup.cfg package.xml pyproject.toml
	@echo "installing the package and what it needs (about 600 MB the first time)"
	$(PIP) --editable '.$(EXTRAS)' | $(TRIM)
	touch $@

.venv/installed-test: .venv/installed
	@echo "installing what the tests need"
	$(PIP) --editable '.$(TEST_EXTRAS)' | $(TRIM)
	touch $@

# The test with Foxglove's own readers is skipped where these cannot be installed.
.venv/installed-js: .venv/made-for test/js/package.json
	@command -v node >/dev/null && command -v npm >/dev/null || \
		{ echo "no Node.js with npm here: the test with Foxglove's readers is skipped"; exit 0; }
	echo "installing Foxglove's readers for a test (npm)"
	mkdir -p .venv/js
	cp test/js/package.json .venv/js/
	cd .venv/js
	npm install --no-audit --no-fund --no-update-notifier --loglevel=error >/dev/null || \
		{ echo "npm could not install them: that test is skipped"; exit 0; }
	touch ../installed-js

.venv/installed-lint: .venv/installed
	@echo "installing the linters"
	$(PIP) --editable '.[lint]' | $(TRIM)
	touch $@

.venv/warm: .venv/installed $(wildcard $(foreach room,symbols mechanisms model planning estimation control,dextar_control/$(room)/*.py))
	@$(BIN)/python -m dextar_control.control.prepare
	touch $@
