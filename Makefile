# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
# `make run`, `make loop` and `make test` do all of their set-up in $(VENV); `make help` lists all.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

VENV ?= .venv
BENCH_VENV ?= .venv-bench
# the interpreter to make the environments with; empty: the first of the candidates that serves
PYTHON ?=
# a NumPy release to hold to, such as 1.26; empty: the newest that the other packages allow
NUMPY ?=
TEST_TIMEOUT ?= 600
PYTEST_ARGS ?=
# further options of make bench
BENCH_ARGS ?=
# processes that share the tests
WORKERS ?= 2
LOOP_ARGS ?=
# records of make score, the seed of the first one (920000 and above), further options
SCORE_COUNT ?= 390
SCORE_SEED ?= 920000
SCORE_ARGS ?=
# seeds and further options of make machines
MACHINES_ARGS ?=
# machines of make rigs, such as 'xl330 emps' (empty: all), and further options
RIGS ?=
RIGS_ARGS ?=

# A sourced ROS installation and the wheels of rclpy in $(VENV) must not mix: neither its modules
# and libraries, nor a middleware that the wheels do not have. ROS_DOMAIN_ID stays the user's.
unexport PYTHONPATH PYTHONHOME LD_LIBRARY_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE VIRTUAL_ENV PIP_USER PIP_TARGET PIP_PREFIX
# where nothing that is imported may be kept as bytecode, each of some hundred processes compiles all of it again
unexport PYTHONDONTWRITEBYTECODE
FOREIGN := $(filter ROS_% RMW_% RCUTILS_% FASTRTPS_% FASTDDS_% CYCLONEDDS_%,$(.VARIABLES))
$(foreach name,$(filter-out ROS_DOMAIN_ID,$(FOREIGN)),$(eval unexport $(name)))
# where ROS looks for what the wheels installed
export AMENT_PREFIX_PATH := $(abspath $(VENV))
# nothing here may reach a robot on the network
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export ROS_LOG_DIR := $(CURDIR)/build/ros-log

BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed$(if $(NUMPY),-numpy-$(NUMPY))
CANDIDATES := python3.12 python3.11 python3 python3.13 python3.10
SUITABLE := import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 10))

.PHONY: help run loop view test test-all test-long coverage lint docs score machines rigs bench colcon js-readers clean distclean same-python

help:
	@echo "make run         move the simulated arm down a vertical line over ROS 2, record, replay"
	@echo "make loop        record a session with a hidden effect, and find and name it from the bag"
	@echo "make view        show the demonstration in the browser; records it first if it is not there"
	@echo "make test        run the quick tests, in two processes (WORKERS=2)"
	@echo "make test-long   run the long tests of CI; make test-all: all tests there are"
	@echo "make coverage    lines of the core that the quick tests reach"
	@echo "make lint        ruff, mypy, import-linter, codespell"
	@echo "make docs        build the documentation site in build/docs; warnings are errors"
	@echo "make score       explain fresh blind records, print how often that is right (an hour)"
	@echo "make machines    explain simulated logs of other machines, print what was right (half an hour)"
	@echo "make rigs        explain measured logs of real machines, one page (needs PUMA_SIM_DATA; an hour)"
	@echo "make bench       speed beside other simulators (in its own environment, $(BENCH_VENV))"
	@echo "make bench AGAINST=v1  speed beside another revision of this project, in one run"
	@echo "make colcon      build with colcon, run the installed node with an external controller"
	@echo "make js-readers  install the JavaScript bag readers that make test then uses (needs npm)"
	@echo "make clean       remove what was built; make distclean: the environments as well"
	@echo
	@echo "PYTHON=python3.11  the interpreter to use    NUMPY=1.26  hold NumPy to that release"
	@echo "VENV=.venv311      another environment       PYTEST_ARGS='-k bag'  passed on to pytest"
	@echo "SCORE_COUNT=40 SCORE_SEED=920000  records of make score, and the seed of the first"
	@echo "MACHINES_ARGS='--seed 1000 --count 70'  records of make machines"
	@echo "RIGS='xl330 emps' RIGS_ARGS=--no-invariances  machines of make rigs, and its options"
	@echo "LOOP_ARGS='--effect joint_spring:joint=3,stiffness=6'  another effect to hide"

# $(1): the folder of the environment
define make_venv
	@python="$(PYTHON)"; \
	if [ -z "$$python" ]; then \
	    for candidate in $(CANDIDATES); do \
	        if "$$candidate" -c '$(SUITABLE)' >/dev/null 2>&1; then python=$$candidate; break; fi; \
	    done; \
	fi; \
	if [ -z "$$python" ] || ! "$$python" -c '$(SUITABLE)' >/dev/null 2>&1; then \
	    echo "make: $${python:-python3}: not a Python 3.10 or later that has venv."; \
	    echo "      On Debian or Ubuntu: sudo apt install python3 python3-venv"; \
	    echo "      or name another: make PYTHON=/path/to/python3 $(MAKECMDGOALS)"; \
	    exit 1; \
	fi; \
	echo "Making $(1) with $$("$$python" -c 'import sys; print(sys.executable, sys.version.split()[0])')"; \
	"$$python" -m venv --clear "$(1)"; \
	"$(1)/bin/python" -m pip install -q --upgrade pip
	@touch "$(1)/.created"
endef

$(VENV)/.created: | same-python
	$(call make_venv,$(VENV))

# An environment of another release would be used silently.
same-python:
	@if [ -n "$(PYTHON)" ] && [ -e $(VENV)/.created ]; then \
	    version='import sys; print("%d.%d" % sys.version_info[:2])'; \
	    has=$$($(BIN)/python -c "$$version"); asked=$$("$(PYTHON)" -c "$$version"); \
	    if [ "$$has" != "$$asked" ]; then \
	        echo "make: $(VENV) is of Python $$has and PYTHON=$(PYTHON) is $$asked:"; \
	        echo "      name another with VENV=.venv$${asked/./}, or make distclean first"; \
	        exit 1; \
	    fi; \
	fi

$(BENCH_VENV)/.created:
	$(call make_venv,$(BENCH_VENV))

# Only wheels of numba: where there is none, a build from source would need LLVM. What is imported is compiled to bytecode
# then; all of it would take as long as the rest.
PIP_INSTALL = $(BIN)/python -m pip install -q --no-compile --only-binary numba,llvmlite \
    $(if $(NUMPY),-c $(VENV)/constraints.txt)

$(INSTALLED): $(VENV)/.created setup.py pyproject.toml
	@echo "Installing into $(VENV) (a few minutes, about 1 GB, the first time)"
	@echo "$(if $(NUMPY),numpy==$(NUMPY).*)" > $(VENV)/constraints.txt
	@if ! $(PIP_INSTALL) -e '.[fast,ros,test]' > $(VENV)/install.log 2>&1; then \
	    echo "numba cannot be installed here (see $(VENV)/install.log); trying without: the model then"; \
	    echo "runs as plain Python, slower and with the same equations."; \
	    $(PIP_INSTALL) -e '.[ros,test]' > $(VENV)/install-plain.log 2>&1 || { \
	        cat $(VENV)/install-plain.log; \
	        echo "make: the installation failed. If the ros- packages were not found: their wheels are for"; \
	        echo "      Linux on x86-64; elsewhere use a ROS 2 Jazzy installation and colcon (README)."; \
	        exit 1; }; \
	fi
	@touch $@

run: $(INSTALLED)
	@$(BIN)/python examples/sessions/line.py --out build/demo

loop: $(INSTALLED)
	@$(BIN)/python examples/sessions/loop.py --out build/loop $(LOOP_ARGS)

# The last session of the demonstration, with the setpoints that its controller noted.
view: $(INSTALLED)
	@[ -e build/demo/controller.csv ] || $(BIN)/python examples/sessions/line.py --out build/demo
	@$(BIN)/puma-sim view "$$(ls -dt build/demo/bag* | head -n 1)" --setpoints build/demo/controller.csv

# The kernel is compiled before the tests, so that no test waits for it.
$(VENV)/.compiled: $(INSTALLED)
	@echo "Compiling the kernel (up to two minutes, once for each state of its sources)"
	@$(BIN)/python -m puma_sim_core.identify.compile_ahead

.PHONY: $(VENV)/.compiled

# Matrices in the tests are small: beside another process, two threads of linear algebra wait for each other most of the
# time.
define pytest
	@if [ -d build/js/node_modules ]; then \
	    export PUMA_SIM_NODE_MODULES="$${PUMA_SIM_NODE_MODULES:-$(CURDIR)/build/js/node_modules}"; \
	fi; \
	OPENBLAS_NUM_THREADS=$${OPENBLAS_NUM_THREADS:-1} $(BIN)/python -m pytest -q -rs -n $(WORKERS) --dist loadgroup --timeout=$(TEST_TIMEOUT) $(1) $(PYTEST_ARGS)
endef

test: $(VENV)/.compiled
	$(call pytest,-m "not long and not thorough")

test-all: $(VENV)/.compiled
	$(call pytest,)

test-long: $(VENV)/.compiled
	$(call pytest,-m "long and not thorough")

# Lines of the core that the quick tests reach, their processes with the interpreted kernel included.
COVERED := --cov=puma_sim_core --cov-report=

coverage: $(VENV)/.compiled
	@rm -rf build/coverage && mkdir -p build/coverage
	@export COVERAGE_FILE=$(CURDIR)/build/coverage/data; \
	$(MAKE) --no-print-directory test PYTEST_ARGS="$(COVERED) $(PYTEST_ARGS)"; \
	$(BIN)/python test/coverage_table.py

$(VENV)/.lint: $(INSTALLED)
	@$(PIP_INSTALL) -e '.[lint]' > $(VENV)/lint.log 2>&1 || { cat $(VENV)/lint.log; exit 1; }
	@touch $@

lint: $(VENV)/.lint
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check -q .
	@$(BIN)/mypy -p puma_sim_core
	@$(BIN)/lint-imports
	@$(BIN)/codespell puma_sim_core puma_sim_ros benchmarks examples test/*.py docs/*.md docs/_ext README.md Makefile \
	    setup.py CONTRIBUTING.md CHANGELOG.md

$(VENV)/.docs: $(INSTALLED)
	@$(PIP_INSTALL) -e '.[docs]' > $(VENV)/docs.log 2>&1 || { cat $(VENV)/docs.log; exit 1; }
	@touch $@

docs: $(VENV)/.docs
	@$(BIN)/python -m sphinx -q -W --keep-going -b html docs build/docs
	@echo "Documentation: build/docs/index.html"

# Outcomes are kept in build/score: a batch that was interrupted goes on where it stopped.
score: $(INSTALLED)
	@$(BIN)/python test/score/run.py --count $(SCORE_COUNT) --seed $(SCORE_SEED) --out build/score \
	    $(SCORE_ARGS)

# Outcomes are kept in build/machines, as for make score.
machines: $(INSTALLED)
	@$(BIN)/python test/machines/run.py --out build/machines $(MACHINES_ARGS)

# Outcomes are kept in build/rigs, as for make score.
rigs: $(INSTALLED)
	@if [ ! -d "$${PUMA_SIM_DATA:-}" ]; then \
	    echo "make: rigs explains measured logs, which are not part of this project:"; \
	    echo "      PUMA_SIM_DATA=/path/to/the/logs make rigs (docs/rigs.md says which)"; \
	    exit 1; \
	fi
	@$(BIN)/python test/rigs/run.py --out build/rigs $(foreach rig,$(RIGS),--only $(rig)) $(RIGS_ARGS)

# Each peer on its own, and none may move the NumPy or numba that our own rows run on.
PEERS := mujoco pin roboticstoolbox-python casadi
# for the row of the appraisal over topics
BENCH_ROS := ros-jazzy-rclpy[fastrtps] ros-jazzy-common-interfaces

$(BENCH_VENV)/.installed: $(BENCH_VENV)/.created setup.py pyproject.toml
	@echo "Installing into $(BENCH_VENV) (a few minutes the first time)"
	@pip="$(BENCH_VENV)/bin/python -m pip"; log=$(BENCH_VENV)/install.log; \
	if ! $$pip install -q --only-binary numba,llvmlite -e '.[fast]' > $$log 2>&1; then \
	    echo "numba cannot be installed here: our own rows are then those of plain Python"; \
	    $$pip install -q -e . > $$log 2>&1 || { cat $$log; exit 1; }; \
	fi; \
	$$pip freeze | grep -iE '^(numpy|numba|llvmlite|scipy)==' > $(BENCH_VENV)/constraints.txt; \
	for peer in $(PEERS) $(BENCH_ROS); do \
	    $$pip install -q --prefer-binary -c $(BENCH_VENV)/constraints.txt "$$peer" \
	        > "$(BENCH_VENV)/$$peer.log" 2>&1 \
	        || echo "$$peer cannot be installed here (see $(BENCH_VENV)/$$peer.log): no row of it"; \
	done
	@touch $@

bench: $(BENCH_VENV)/.installed
	@$(BENCH_VENV)/bin/python $(if $(AGAINST),benchmarks/against.py $(AGAINST),-m benchmarks) $(BENCH_ARGS)

$(VENV)/.colcon: $(INSTALLED)
	@$(BIN)/python -m pip install -q colcon-common-extensions colcon-ros catkin-pkg \
	    > $(VENV)/colcon.log 2>&1 || { cat $(VENV)/colcon.log; exit 1; }
	@touch $@

# Two scratch workspaces, for both ways to build. colcon gives its own Python to the programs; it
# would warn of an AMENT_PREFIX_PATH that is no workspace.
COLCON_BUILD = env -u AMENT_PREFIX_PATH "$(abspath $(BIN))/colcon" build

colcon: $(VENV)/.colcon
	@rm -rf build/colcon
	@mkdir -p build/colcon/copied build/colcon/linked
	@cd build/colcon/copied && $(COLCON_BUILD) --paths "$(CURDIR)"
	@cd build/colcon/linked && $(COLCON_BUILD) --paths "$(CURDIR)" --symlink-install
	@for workspace in copied linked; do ( \
	    echo "The node of build/colcon/$$workspace with an external controller:"; \
	    set +u; source build/colcon/$$workspace/install/setup.bash; set -u; \
	    $(BIN)/python test/installed_node_check.py --out build/colcon/$$workspace/check ); \
	done

js-readers:
	@mkdir -p build/js
	@npm install --silent --no-audit --no-fund --prefix build/js \
	    @mcap/core @foxglove/rosmsg @foxglove/rosmsg2-serialization
	@echo "JavaScript bag readers: build/js/node_modules"

clean:
	rm -rf build dist install log puma_sim_ros.egg-info .pytest_cache .hypothesis
	find . -name .venv\* -prune -o -name __pycache__ -type d -exec rm -rf {} +

distclean: clean
	rm -rf $(VENV) .venv .venv-bench .venv3*
