# Every target does its own set-up; `make help` lists them.
#   VENV=DIR      the virtual environment (default .venv)
#   PYTHON=EXE    the interpreter to make it with (default: the first usable of 3.11 and 3.13)

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help setup demo gallery pictures site-pictures wheels bench test test-full test-all soak bench-test fuzz lint lint-types lint-style lint-layers lint-contract format schema licences contract docs docs-serve clean

VENV ?= .venv
PYTHON ?=
DEMO_ARGS ?= --out out/survey
GALLERY_ARGS ?= --out out/gallery
PICTURES_ARGS ?= --survey out/survey
BENCH_ARGS ?= --out out/bench
# Many tests wait for discovery, a child or a deadline: three at a time take half as long on two cores.
# The slowest files come first, see test/conftest.py; xdist would begin with those of most tests.
PYTEST_ARGS ?= -n 3 --dist loadfile --no-loadscope-reorder
# Each run of many tests ends with a table of its slowest ones, before pytest's closing line.
SLOWEST := --durations=20 --durations-min=1
# The tools' own arithmetic and runs promise nothing to users, and what notebooks and wheels hold is
# tested elsewhere; they have a target of their own.
BENCH_TESTS := test/bench
FUZZ_SECONDS ?= 60
# The demo tells its seconds from here on, set-up included.
STARTED_S := $(shell date +%s.%N)

IN_ENV := source '$(abspath $(VENV))/oaisys_env.sh' &&
# Folders: mypy takes no packages beside them, and the helpers of the tests are no package.
TYPED := $(foreach name,core dataset grpc gym mapping ros_bridge,oaisys_$(name)/oaisys_$(name)) tools test

help: ## Show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: ## Make the virtual environment and build what the project needs
	@VENV='$(VENV)' PYTHON='$(PYTHON)' tools/setup.sh

demo: setup ## Survey a rocky terrain from 30 viewpoints and rebuild it: out/survey/report.html
	@$(IN_ENV) OAISYS_STARTED_S='$(STARTED_S)' oaisys survey $(DEMO_ARGS)

gallery: setup ## Render every example and texture set with its labels: out/gallery/index.html
	@$(IN_ENV) python -m tools.gallery $(GALLERY_ARGS)

pictures: demo ## Make the README's pictures from six worlds and the demo's survey
	@$(IN_ENV) python -m tools.gallery.readme $(PICTURES_ARGS)

site-pictures: setup ## Make the site's small pictures of names and keys (SITE_PICTURES_ARGS='textures --missing')
	@$(IN_ENV) python -m tools.gallery.names $(SITE_PICTURES_ARGS)

wheels: setup ## Build the wheels of all packages: out/wheels
	@$(IN_ENV) python -m tools.wheels out/wheels

bench: setup ## Measure everything: out/bench/bench.md (five hours the first time; BENCH_ARGS='--only transfer', --quick)
	@$(IN_ENV) python -m tools.bench $(BENCH_ARGS)

test: setup ## Run the tests but for the long ones (about 10 minutes on two cores)
	@$(IN_ENV) pytest $(PYTEST_ARGS) $(SLOWEST) --ignore=$(BENCH_TESTS) -m 'not long and not soak'

test-full: setup ## Run the long tests: every example, faults, both sizes of survey (about 14 minutes)
	@$(IN_ENV) pytest $(PYTEST_ARGS) $(SLOWEST) --ignore=$(BENCH_TESTS) -m long

test-all: setup ## Run the tests of `make test` and of `make test-full` at once, as CI has them (about 22 minutes)
	@$(IN_ENV) pytest $(PYTEST_ARGS) $(SLOWEST) --ignore=$(BENCH_TESTS) -m 'not soak'

soak: setup ## Run what repeats other tests for long: 10,000 requests, kills again and again, further presets, memory (half an hour or more)
	@$(IN_ENV) pytest $(PYTEST_ARGS) $(SLOWEST) --ignore=$(BENCH_TESTS) -m soak

bench-test: setup ## Run the tests of the bench, the look book, the site's build, the notebooks and the wheels (about 7 minutes for the bench's)
	@$(IN_ENV) pytest $(PYTEST_ARGS) $(SLOWEST) $(BENCH_TESTS)

fuzz: setup ## Send a server random and mutated requests for FUZZ_SECONDS (60)
	@$(IN_ENV) FUZZ_SECONDS='$(FUZZ_SECONDS)' pytest -q -s test/grpc/server/test_fuzz.py

lint: setup ## Check style, formatting, the layers, types and the gRPC contract
	@$(MAKE) --no-print-directory --jobs 2 --output-sync lint-types lint-style lint-layers lint-contract

# Kept for all checkouts of a user: a cold one takes a minute of a core, a warm one a second.
lint-types: export MYPY_CACHE_DIR ?= $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/oaisys/mypy
lint-types:
	@$(IN_ENV) mypy $(TYPED)

lint-style:
	@$(IN_ENV) ruff check .
	@$(IN_ENV) ruff format --check .

lint-layers:
	@$(IN_ENV) lint-imports --no-logo

lint-contract:
	@tools/buf.sh '$(abspath $(VENV))/buf'

format: setup ## Rewrite the code in the project's format
	@$(IN_ENV) ruff check --fix .
	@$(IN_ENV) ruff format .

schema: setup ## Write the configuration's schema and the reference pages anew from the code
	@$(IN_ENV) oaisys config schema --out config/schema.json
	@$(IN_ENV) oaisys config reference --out docs/configuration.md
	@$(IN_ENV) oaisys config names --out docs/names.md
	@$(IN_ENV) oaisys ros reference --out docs/ros.md

licences: setup ## Write the tables of docs/licences.md anew from the installed packages
	@$(IN_ENV) python -m tools.licences

contract: setup ## Make today's gRPC contract the released one, which `make lint` lets nobody break
	@tools/buf.sh '$(abspath $(VENV))/buf' release

docs: setup ## Build the documentation site strictly: out/docs/site/index.html
	@$(IN_ENV) tools/docs.sh '$(abspath $(VENV))/docs' build --strict --quiet

docs-serve: setup ## Serve the site at http://127.0.0.1:8000
	@$(IN_ENV) tools/docs.sh '$(abspath $(VENV))/docs' serve

clean: ## Remove the virtual environment and everything generated
	@rm -rf '$(VENV)' '$(VENV).lock' oaisys_grpc/oaisys_grpc/pb out
