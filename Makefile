# Every target sets up what it needs in .venv first; PYTHON=/path/to/python3.11 chooses the interpreter.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help demo test check format lock clean distclean setup-demo setup-test

BIN := .venv/bin
UV ?= uv
ARGS ?=

# Test workers run side by side: one thread each for linear algebra, and two for Numba so that its parallel
# kernels are tested as such.
THREADS := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 NUMBA_NUM_THREADS=2

# Ray pins one exact Gymnasium and cannot be locked with the rest. The CUDA packages are torch's own choice, wanted by
# nobody who has its CPU build.
LOCKED_EXTRAS := data demo dev mesh teleop train video viewer viz window zoo
CUDA := ^(cuda-|nvidia-|triton==)

help:  ## Show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: setup-demo  ## Set up, then reproduce the contact model's figures and run an episode
	@$(BIN)/spatula demo $(ARGS)

test: setup-test  ## Set up, then run the tests; ARGS="tests/contact -n 0" is passed to pytest
	@$(THREADS) $(BIN)/python -m pytest $(ARGS)

check: setup-test  ## Set up, then lint, check the format, the types and the spelling
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/codespell

format: setup-test  ## Format the code and mend what ruff can
	$(BIN)/ruff check --fix --exit-zero
	$(BIN)/ruff format

lock:  ## Renew requirements/lock.txt (needs uv)
	@command -v $(UV) >/dev/null || { echo 'error: "make lock" needs uv: install it, or name it: UV=/path/to/uv' >&2; exit 1; }
	@{ echo '# The version of everything that pyproject.toml and requirements/build.in lead to. Written by `make lock`.'; \
	  $(UV) pip compile --quiet --universal --python-version 3.10 --no-header --no-annotate --no-emit-index-url \
	    $(LOCKED_EXTRAS:%=--extra %) pyproject.toml requirements/build.in | grep -vE '$(CUDA)'; \
	} >requirements/lock.txt.new
	@mv requirements/lock.txt.new requirements/lock.txt
	@echo 'requirements/lock.txt is renewed; "make check test" tells whether all goes well with it.'

clean:  ## Remove caches and build outputs
	rm -rf build dist .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -path ./.venv -prune -o -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean  ## Remove .venv as well
	rm -rf .venv

setup-demo:
	@scripts/bootstrap.sh demo

setup-test:
	@scripts/bootstrap.sh test
