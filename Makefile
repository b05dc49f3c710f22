# Every command makes .venv if it is missing and installs what it needs: nothing to prepare by hand.

# Asked for only when .venv has to be made. The names are run, not just looked up: a pyenv shim exists for
# versions that are not switched on. PYTHON=... chooses another.
PYTHON ?= $(shell for p in python3.11 python3 python3.12 python3.13 python3.14; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && echo $$p && break; done)

BIN := .venv/bin
INSTALLED := .venv/.installed
WITH_DOCS := .venv/.docs
WHEEL := dist/.wheel
# Folders too: their date tells that a file was taken away.
SOURCES := $(shell find cyclofeat simulators datasets -name __pycache__ -prune -o -print) LICENSE README.md

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow test-nojit test-browser test-array-api test-oldest coverage lint types contracts wheel-check docs bench-simulator bench-features bench-campaign bench-counting bench-spoiled bench-wear bench-posterior-peers default-models default-domains bench-asv papers test-gap bench-gap clean

help:  ## list the commands
	@sed -n 's/^\([a-z-]*\):.*##/  make \1:/p' Makefile | sed 's/:  */\t/' | expand -t 22

# Depends on pyproject.toml alone: the install is editable, so only new dependencies or packages need another.
$(INSTALLED): pyproject.toml
	@if ! $(BIN)/python -m pip --version >/dev/null 2>&1; then \
		if ! $(or $(PYTHON),false) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
			echo "cyclofeat needs Python 3.11 or newer, got '$(PYTHON)'. Name one: make PYTHON=python3.12 ..." >&2; \
			exit 1; \
		fi; \
		echo "Making .venv with $(PYTHON)"; \
		$(PYTHON) -m venv .venv >/dev/null 2>&1 || \
			{ $(PYTHON) -m venv --clear --without-pip .venv && \
			  $(PYTHON) -m pip --python .venv/bin/python install -q pip; }; \
	fi
	@echo "Installing into .venv (some minutes on a slow line)"
	$(BIN)/python -m pip install -q --disable-pip-version-check --no-compile -e '.[test,lint]'
	@$(BIN)/python -m compileall -q -j 0 .venv/lib >/dev/null 2>&1 || true  # pip would use one core alone
	@touch $@

$(WITH_DOCS): $(INSTALLED)
	$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[docs]'
	@touch $@

demo: $(INSTALLED)  ## simulate, train, count worn lobes from files; writes demo/count.html and demo/evaluation.html
	$(BIN)/python -m cyclofeat demo --out demo --force

# One BLAS thread: same sums on every machine, and no threads that fight with joblib's workers.
test test-slow test-nojit test-browser test-array-api coverage: export OPENBLAS_NUM_THREADS = 1
# Both processes of a run, and the next run, read the same bytecode.
test test-slow: export PYTHONDONTWRITEBYTECODE =

# Two files at a time: what a file's tests share is made once.
test: $(INSTALLED)  ## the tests, without those marked slow, bench or browser
	$(BIN)/pytest -n 2 --dist loadfile -m "not slow and not bench and not browser"

test-slow: $(INSTALLED)  ## the tests marked slow: over half a second each, or with a kernel of their own to compile
	$(BIN)/pytest -n 2 --dist loadfile -m "slow and not bench and not browser" || [ $$? -eq 5 ]  # 5: there are none

# Numba can hide an index out of bounds or an undefined name: the interpreter does not.
test-nojit: $(INSTALLED)  ## the tests marked nojit, without compilation
	NUMBA_DISABLE_JIT=1 $(BIN)/pytest -m nojit

# An environment variable that scipy reads when it is imported.
test-array-api: $(INSTALLED)  ## scikit-learn's checks with arrays of other libraries
	SCIPY_ARRAY_API=1 $(BIN)/pytest -k array_api tests/test_common.py

coverage: $(INSTALLED)  ## lines and branches that the tests run, slow ones too; fails below 95 %
	$(BIN)/pytest -n 2 --dist loadfile -m "not bench and not browser" --cov --cov-report=term

test-browser: $(INSTALLED)  ## the pages of reports, animations and the server in Chromium
	$(BIN)/pytest -m browser tests/browser

lint: $(INSTALLED)  ## ruff: rules and format; spelling; workflows; scientific-python's review of repositories
	$(BIN)/ruff check .
	$(BIN)/ruff check --preview --select PLW1514 .  # text without an encoding
	$(BIN)/ruff format --check .
	git ls-files -z | xargs -0 $(BIN)/codespell
	$(BIN)/zizmor --quiet --offline --strict-collection .github
	$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml
	$(BIN)/repo-review --show err .

# The wheel comes from the source distribution, so both are proved whole, and a stale build/ cannot slip in.
$(WHEEL): $(INSTALLED) $(SOURCES)
	rm -rf dist
	@mkdir dist
	$(BIN)/pyproject-build . > dist/build.log 2>&1 || { cat dist/build.log; exit 1; }
	$(BIN)/twine check --strict dist/*.whl dist/*.tar.gz
	$(BIN)/check-wheel-contents dist/*.whl
	$(BIN)/python -m zipfile -e dist/cyclofeat-*.whl dist/tree
	@touch $@

# mypy and import-linter find cyclofeat.simulators and cyclofeat.datasets only where they lie below cyclofeat.
# Benchmarks are run by hand: that they call the package as it is, is all that is checked of them.
types: $(WHEEL)  ## mypy, strict, on the unpacked wheel; calls and names in the benchmarks
	cd dist/tree && $(CURDIR)/$(BIN)/mypy --config-file $(CURDIR)/pyproject.toml \
		--cache-dir $(CURDIR)/.mypy_cache -p cyclofeat
	MYPYPATH=dist/tree:. $(BIN)/mypy --config-file= --cache-dir .mypy_cache/benchmarks --ignore-missing-imports \
		--explicit-package-bases $(addprefix --disable-error-code=,arg-type assignment index misc operator \
		return-value union-attr no-redef) benchmarks

contracts: $(WHEEL)  ## who may import whom, on the unpacked wheel
	cd dist/tree && $(CURDIR)/$(BIN)/lint-imports --config $(CURDIR)/pyproject.toml --no-cache

wheel-check: $(WHEEL)  ## install the wheel into an empty environment and use it from another folder
	bash .ci/with_wheel "" python $(CURDIR)/.ci/wheel_check.py

test-oldest: $(WHEEL)  ## the same with the oldest supported dependencies, and scikit-learn's own checks
	bash .ci/with_wheel oldest sh -c 'python $(CURDIR)/.ci/wheel_check.py && \
		pytest -p no:cacheprovider -m "not slow" $(CURDIR)/tests/test_common.py'

docs: $(WITH_DOCS)  ## the documentation with its gallery, executed; writes docs/_build/html
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m sphinx -E -W --keep-going -q -b html docs docs/_build/html

bench-simulator: $(INSTALLED)  ## the simulator's speed; writes benchmarks/simulator.md
	$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[bench]'
	$(BIN)/python benchmarks/simulator.py

bench-features: $(INSTALLED)  ## the features' speed and memory; writes benchmarks/features.md
	$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[bench]'
	$(BIN)/python benchmarks/features.py

RUNS ?= 512
bench-campaign: $(INSTALLED)  ## a campaign's speed and memory; writes benchmarks/campaign.md
	$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[bench,cluster,io]'
	$(BIN)/python benchmarks/campaign.py --runs $(RUNS)

# aeon pins libraries older than ours: an environment of its own.
bench-counting: $(INSTALLED)  ## the counter beside its goals and other methods; writes benchmarks/counting.md
	$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[bench,report]'
	@test -d build/counting/venv/lib/python*/site-packages/aeon || \
		{ $(BIN)/python -m venv build/counting/venv && build/counting/venv/bin/pip install -q aeon; }
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.counting

bench-spoiled: $(INSTALLED)  ## what becomes of spoiled recordings; writes benchmarks/spoiled.md
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.spoiled

bench-wear: $(INSTALLED)  ## count and depth of early radial wear; writes benchmarks/wear.md
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.wear

TABLES = bench-operating-points bench-disc-sizes bench-speed-search bench-sampling-rates bench-drawn-rigs bench-real-gaps bench-other-models
.PHONY: $(TABLES)
$(TABLES): bench-%: $(INSTALLED)
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.$(subst -,_,$*)

# Output torque needs more assemblies: its lobe lines hide in the resonance of rotor and torque meter.
# Coarser models, for fewer samples per turn, go into the file of the next: quantity, samples per turn,
# assemblies, epochs.
default-models: $(INSTALLED)  ## train the packaged models (some hours, 20 GB of memory); writes cyclofeat/models/default
	mkdir -p build/models
	for one in output_torque:37:3000 output_torque:128:1000 output_torque:256:10000:80 \
		input_torque:37:1800:80 input_torque:128:1800:80 motor_current:37:900 motor_current:128:2000:80; do \
		set -- $$(echo $$one | tr : ' '); out=build/models/$$1.skops; \
		if [ $$2 -gt 37 ]; then mv $$out build/models/coarser.skops; fi; \
		OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/cyclofeat train --quantity $$1 --counter rows \
			--samples-per-turn $$2 --speeds 100:1500 --loads 3:40 --assemblies $$3 $${4:+--epochs $$4} --windows 1 \
			$$([ $$2 -eq 37 ] || echo --coarser build/models/coarser.skops) --force --out $$out || exit 1; \
	done
	cp build/models/output_torque.skops* build/models/input_torque.skops* build/models/motor_current.skops* \
		cyclofeat/models/default

default-domains: $(INSTALLED)  ## learn what the packaged models take to be like their training data (10 minutes)
	for one in output_torque input_torque motor_current; do \
		OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/cyclofeat train --domain-of cyclofeat/models/default/$$one.skops \
			--speeds 100:1500 --loads 3:40 --assemblies 200 --windows 1 --seed 1 --jobs 2 --force \
			--out cyclofeat/models/default/$$one.skops || exit 1; \
	done

# Their libraries need a torch of some gigabytes: an environment of its own.
bench-posterior-peers: $(INSTALLED)  ## the gap's posterior beside sbi, BayesFlow, forests; writes benchmarks/posterior_peers.md
	@test -d build/posterior_peers/venv/lib/python*/site-packages/bayesflow || \
		{ $(BIN)/python -m venv build/posterior_peers/venv && \
		  build/posterior_peers/venv/bin/pip install -q torch sbi bayesflow; }
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.posterior_peers

COMMITS ?= HEAD^!
bench-asv: $(INSTALLED)  ## speed of features, counter and simulator over COMMITS (v0.2.0..HEAD); writes build/asv/html
	$(BIN)/python -m pip install -q --disable-pip-version-check 'asv[virtualenv]>=0.6'
	cd benchmarks/asv && $(CURDIR)/$(BIN)/asv machine --yes && \
		$(CURDIR)/$(BIN)/asv run --skip-existing $(COMMITS) && $(CURDIR)/$(BIN)/asv publish

papers: $(INSTALLED)  ## both papers' statements; writes docs/papers_statements.csv
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.papers

test-gap: $(INSTALLED)  ## the gap workflow's longest tests: generator and simulator, a killed run
	$(BIN)/pytest -m bench tests/gap

bench-gap: $(INSTALLED)  ## the gap workflow on 100 hidden sets (some two hours); writes benchmarks/gap.md
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.gap

clean:  ## remove what the commands made (.venv stays)
	rm -rf build dist demo cyclofeat.egg-info .pytest_cache .tox .coverage .mypy_cache .ruff_cache .hypothesis
	rm -rf docs/_build docs/gallery docs/generated docs/sg_execution_times.rst
	find cyclofeat simulators datasets tests examples -name __pycache__ -prune -exec rm -rf {} +
