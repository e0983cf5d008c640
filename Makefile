# Two commands set everything up on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin

.PHONY: demo test test-slow check bench bench-check clean

demo: $(VENV)/.demo
	$(BIN)/python -m spdz demo

# On all cores; each file's tests stay together, since they share what they have dealt.
test: $(VENV)/.test
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile

# The same tests with thousands of random programs, lies of an insider, and drops at every byte (about an hour).
test-slow: $(VENV)/.test
	SPDZ_RANDOM_PROGRAMS=4000 SPDZ_INSIDER_TRIALS=60 SPDZ_DROPS=4000 $(BIN)/python -m pytest --timeout 3600 \
		tests/test_random_programs.py tests/test_insider.py tests/test_matcher.py tests/test_gallery_stream.py

check: $(VENV)/.check
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(VENV)/.test
	$(BIN)/python -m bench --score S10 --dim 8192 --security malicious --trials 10

# Ratios within one run, held to bench/check/ratios.json. Not part of the tests: it measures time, about a minute.
bench-check: $(VENV)/.test
	$(BIN)/python -m bench check

# One marker file an extra; a change of pyproject.toml installs again.
$(VENV)/.demo: EXTRA = demo
$(VENV)/.test: EXTRA = test,demo
$(VENV)/.check: EXTRA = check,test,demo
$(VENV)/.%: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[$(EXTRA)]'
	touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
