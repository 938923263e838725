# Every target sets up what it needs in .venv first; PYTHON=/path/to/python3.11 chooses the interpreter.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help demo test test-ray test-libraries check format lock clean distclean setup-demo setup-test setup-ray setup-libraries

BIN := .venv/bin
UV ?= uv
ARGS ?=

# Test workers run side by side: one thread each for linear algebra, and two for Numba so that its parallel
# kernels are tested as such.
THREADS := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 NUMBA_NUM_THREADS=2

# Ray pins one exact Gymnasium, so it has a lock and an environment of its own. The CUDA packages are torch's own
# choice, wanted by nobody who has its CPU build.
LOCKED_EXTRAS := data demo dev mesh teleop train video viewer viz web window zoo
RAY_EXTRAS := dev ray
CUDA := ^(cuda-|nvidia-|triton==)

help:  ## Show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: setup-demo  ## Set up, then reproduce the contact model's figures and run an episode
	@$(BIN)/spatula demo $(ARGS)

test: setup-test  ## Set up, then run the tests; ARGS="tests/contact -n 0" is passed to pytest
	@$(THREADS) $(BIN)/python -m pytest -rs $(ARGS)

test-ray: setup-ray  ## Set up .venv-ray, then run the tests that need Ray
	@$(THREADS) .venv-ray/bin/python -m pytest -rs -m ray -n 0 $(or $(ARGS),tests/agents/test_rllib.py)

test-libraries: setup-libraries  ## Set up .venv-libraries, then run the tests with other RL libraries
	@$(THREADS) .venv-libraries/bin/python -m pytest -rs -m libraries -n 0 $(ARGS)

check: setup-test  ## Set up, then lint, check the format, the types and the spelling
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/codespell

format: setup-test  ## Format the code and mend what ruff can
	$(BIN)/ruff check --fix --exit-zero
	$(BIN)/ruff format

lock:  ## Renew requirements/lock.txt and lock-ray.txt (needs uv)
	@command -v $(UV) >/dev/null || { echo 'error: "make lock" needs uv: install it, or name it: UV=/path/to/uv' >&2; exit 1; }
	$(call lock_file,lock.txt,$(LOCKED_EXTRAS))
	$(call lock_file,lock-ray.txt,$(RAY_EXTRAS))
	@echo 'The locks are renewed; "make check test test-ray" tells whether all goes well with them.'

# A lock, all at once. $(1): its name, $(2): the extras in it.
define lock_file
@{ echo '# The version of everything that pyproject.toml and requirements/build.in lead to. Written by `make lock`.'; \
  $(UV) pip compile --quiet --universal --python-version 3.10 --no-header --no-annotate --no-emit-index-url \
    $(2:%=--extra %) pyproject.toml requirements/build.in | grep -vE '$(CUDA)'; \
} >requirements/$(1).new
@mv requirements/$(1).new requirements/$(1)
endef

clean:  ## Remove caches and build outputs
	rm -rf build dist .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -path './.venv*' -prune -o -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean  ## Remove .venv, .venv-ray and the like as well
	rm -rf .venv .venv-*

setup-demo:
	@scripts/bootstrap.sh demo

setup-test:
	@scripts/bootstrap.sh test

setup-ray:
	@scripts/bootstrap.sh ray

setup-libraries:
	@scripts/bootstrap.sh libraries
