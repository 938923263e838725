# Every target sets up what it needs in .venv first; PYTHON=/path/to/python3.12 chooses the interpreter, of CPython 3.10 to 3.13.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help demo test test-fast test-without-bullet test-ray test-lerobot test-libraries test-matrix test-all check format lock slow-tests \
	docs dist check-dist clean distclean setup-demo setup-test setup-ray setup-lerobot setup-libraries setup-matrix setup-docs

BIN := .venv/bin
UV ?= uv
ARGS ?=

# Test workers run side by side: one thread each for linear algebra, and two for Numba so that its parallel
# kernels are tested as such.
THREADS := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 NUMBA_NUM_THREADS=2

# Ray pins one exact Gymnasium, so it has a lock and an environment of its own. The CUDA packages are torch's own
# choice, wanted by nobody who has its CPU build.
LOCKED_EXTRAS := anatomy data demo dev mesh mujoco teleop test train video viewer viz web window zoo
RAY_EXTRAS := ray test
LEROBOT_EXTRAS := lerobot test
LIBRARIES_EXTRAS := test train
CUDA := ^(cuda-|nvidia-|triton==)

help:  ## Show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-20s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: setup-demo  ## Set up, then reproduce the contact model's figures and run an episode
	@$(BIN)/spatula demo $(ARGS)

# Tests have five minutes each; on a slow machine, compiling takes more.
test: setup-test  ## Set up, compile, then run the tests; ARGS="tests/contact -n 0" is passed to pytest
	@PYTHONDONTWRITEBYTECODE= $(THREADS) $(BIN)/spatula compile
	@$(call pytest,$(BIN)) $(ARGS)

test-fast: setup-test  ## Set up, then run those tests that take no time, under a minute in all
	@$(call pytest,$(BIN)) -q -m "not slow" $(ARGS)

slow-tests: test  ## Run the tests, then list anew which of them are slow; on a machine that does nothing else
	$(BIN)/python scripts/slow_tests.py $(RESULTS)/test.xml

test-without-bullet: setup-test  ## Set up, then run the tests as if PyBullet were not installed
	@SPATULA_TESTS_WITHOUT_BULLET=1 $(call pytest,$(BIN)) $(ARGS)

test-ray: setup-ray  ## Set up .venv-ray, then run the tests that need Ray
	@$(call pytest,.venv-ray/bin) -m ray -n 0 $(or $(ARGS),tests/learning/test_rllib.py)

test-lerobot: setup-lerobot  ## Set up .venv-lerobot with Python 3.12 (6 GB), then run the tests that need LeRobot
	@$(call pytest,.venv-lerobot/bin) -m lerobot -n 0 $(or $(ARGS),tests/data tests/envs/test_lerobot_adapter.py)

test-libraries: setup-libraries  ## Set up .venv-libraries, then run the tests with other RL libraries
	@$(call pytest,.venv-libraries/bin) -m libraries -n 0 $(or $(ARGS),tests/libraries tests/data/test_d3rlpy_dataset.py)

test-matrix: setup-matrix  ## Install and test with each CPython from 3.10 on that is here, one after the other
	@PATH="$$(scripts/bootstrap.sh interpreters | paste -sd:):$$PATH" $(THREADS) .venv-matrix/bin/nox \
	  --no-error-on-missing-interpreters --no-error-on-external-run -s core -- $(ARGS)

# What is skipped in one environment and run in another is not amiss: the summary tells what none of them has run.
test-all:  ## All of the above, then what was skipped in all of them, and why
	@rm -rf $(RESULTS); failed=""; \
	for suite in test test-without-bullet test-ray test-lerobot test-libraries test-matrix; do \
	  printf '\n== make %s\n' "$$suite"; $(MAKE) --no-print-directory "$$suite" ARGS= || failed+=" $$suite"; \
	done; \
	$(BIN)/python scripts/summarize_tests.py $(RESULTS) $${failed:+--failed $$failed}

RESULTS := build/test-results
SITE := docs/_build

# $(1): the folder of the interpreter. The result of each test is written into a file with the name of the target.
# Python keeps what it has compiled, for the many processes that tests start, whatever is said outside.
pytest = PYTHONDONTWRITEBYTECODE= $(THREADS) $(1)/python -m pytest -rs --junitxml=$(RESULTS)/$@.xml

check: setup-test  ## Set up, then lint, check the format, the types and the spelling
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/codespell

format: setup-test  ## Format the code and mend what ruff can
	$(BIN)/ruff check --fix --exit-zero
	$(BIN)/ruff format

docs: setup-docs  ## Set up .venv-docs, then build the site of the documentation in docs/_build; warnings are errors
	@rm -rf $(SITE)
	@OMP_NUM_THREADS=1 .venv-docs/bin/python -m sphinx --quiet --fail-on-warning --keep-going --builder html \
	  --conf-dir docs --doctree-dir build/doctrees --fresh-env . $(SITE) $(ARGS)
	@echo 'The site is in $(SITE): open $(SITE)/index.html'

dist: setup-docs  ## Build the source archive and the wheel in dist
	@rm -rf dist
	@.venv-docs/bin/python -m hatchling build

check-dist: dist  ## Build both, then check what package indexes ask of their metadata
	@.venv-docs/bin/python -m twine check --strict dist/*

lock:  ## Renew the locks in requirements (needs uv)
	@command -v $(UV) >/dev/null || { echo 'error: "make lock" needs uv: install it, or name it: UV=/path/to/uv' >&2; exit 1; }
	$(call lock_file,lock.txt,$(LOCKED_EXTRAS),--python-version 3.10,$(CUDA))
	$(call lock_file,lock-ray.txt,$(RAY_EXTRAS),--python-version 3.10,$(CUDA))
	$(call lock_file,lock-lerobot.txt,$(LEROBOT_EXTRAS),--python-version 3.12 --no-config,^$$)
	$(call lock_file,lock-libraries.txt,$(LIBRARIES_EXTRAS),--python-version 3.11 requirements/libraries.in,$(CUDA))
	$(call lock_file,lock-docs.txt,,--python-version 3.11 requirements/docs.in,^$$)
	@echo 'The locks are renewed; "make check test test-ray" tells whether all goes well with them.'

# A lock, all at once. $(1): its name, $(2): the extras in it, $(3): options of uv, $(4): what is left out. LeRobot's is
# made without pyproject.toml's wish for one torch, and keeps CUDA, because there is no CPU build of the one it takes.
define lock_file
@{ echo '# The version of everything that pyproject.toml and requirements/build.in lead to. Written by `make lock`.'; \
  $(UV) pip compile --quiet --universal --no-header --no-annotate --no-emit-index-url $(3) \
    $(2:%=--extra %) pyproject.toml requirements/build.in | grep -vE '$(4)'; \
} >requirements/$(1).new
@mv requirements/$(1).new requirements/$(1)
endef

clean:  ## Remove caches and build outputs
	rm -rf .nox build dist docs/_build .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -path './.venv*' -prune -o -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean  ## Remove .venv, .venv-ray and the like as well
	rm -rf .venv .venv-*

setup-demo:
	@scripts/bootstrap.sh demo

setup-test:
	@scripts/bootstrap.sh test

setup-ray:
	@scripts/bootstrap.sh ray

setup-lerobot:
	@scripts/bootstrap.sh lerobot

setup-matrix:
	@scripts/bootstrap.sh matrix

setup-libraries:
	@scripts/bootstrap.sh libraries

setup-docs:
	@scripts/bootstrap.sh docs
