# Two commands matter: `make demo` shows what it does, `make test` checks everything. Both set themselves up.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SOURCES := $(shell find src shaders -type f 2>/dev/null) Cargo.toml Cargo.lock pyproject.toml

.PHONY: help demo test test-release test-long check types bench bench-quick hardware docs fix wheel portable clean

help: ## Show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(VENV)/.built ## Bake real geometry, save it, draw it: pictures in out/
	$(BIN)/fieldbake demo --output out

test: check types ## Everything CI runs: format, lints, types, Rust tests, Python tests
	PROPTEST_RNG_SEED=0 cargo test --profile develop --quiet
	PYOPENGL_PLATFORM=osmesa $(BIN)/pytest -n 2 -m "not slow" --durations 20

test-release: $(VENV)/.released $(VENV)/.test ## The tests of distances, signs, queries and rays on the build that is released
	$(BIN)/pytest -n 2 -m "not slow" tests/baking tests/queries tests/meshes

test-long: $(VENV)/.built $(VENV)/.test $(VENV)/.long $(VENV)/.docs ## What `make test` leaves out: new random cases, slow tests, builds of 1 to 256 units
	PROPTEST_CASES=1000 cargo test --profile develop --quiet
	PYOPENGL_PLATFORM=osmesa $(BIN)/pytest -n 2 -m slow
	scripts/check_units.sh

check: $(VENV)/.lint ## Format, layers, spelling, named paths and wording, in seconds and without a build
	$(BIN)/ruff format --check --quiet .
	$(BIN)/ruff check --quiet .
	cargo fmt --check
	PYTHONPATH=python $(BIN)/lint-imports --no-logo --no-cache
	$(BIN)/typos
	$(BIN)/python scripts/check_paths.py
	$(BIN)/python scripts/check_text.py

types: $(VENV)/.built $(VENV)/.test ## Clippy, rustdoc, mypy, and the stub beside the compiled module
	cargo clippy --profile develop --quiet --all-targets --features python -- --deny warnings
	RUSTDOCFLAGS="--deny warnings" cargo doc --profile develop --quiet --no-deps --features python
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest fieldbake._core --ignore-disjoint-bases

docs: $(VENV)/.built $(VENV)/.docs ## Execute and build the documentation site: docs/build/html/index.html
	$(BIN)/python -m sphinx -W --keep-going --quiet docs docs/build/html

bench: $(VENV)/.released $(VENV)/.bench ## Every benchmark beside other tools, in 40 minutes; goes on after an interruption
	$(BIN)/python benches/run.py

bench-quick: $(VENV)/.released ## Core figures in 3 minutes, compared with the last recorded ones
	$(BIN)/python benches/quick.py

hardware: $(VENV)/.released $(VENV)/.test ## Test and measure a graphics card: benches/results/DATE-hardware-CARD.md
	$(BIN)/python benches/hardware.py

fix: $(VENV)/.lint ## Format, and repair what lints can repair
	$(BIN)/ruff check --fix --quiet . || true
	$(BIN)/ruff format --quiet .
	cargo fmt

wheel: $(VENV)/.made ## Build the wheel for this machine into dist/
	RUSTFLAGS="$$(scripts/remap_paths.sh)" $(BIN)/maturin build --release --out dist
	$(BIN)/python scripts/check_wheel.py "$$(ls -t dist/*.whl | head -1)"

portable: $(VENV)/.made ## Build a wheel for every Linux with glibc 2.28 or newer into dist/
	$(BIN)/pip install --quiet --group release
	PATH="$(CURDIR)/$(BIN):$$PATH" RUSTFLAGS="$$(scripts/remap_paths.sh)" $(BIN)/maturin build --release --locked --zig \
		--compatibility manylinux_2_28 --out dist
	$(BIN)/auditwheel show dist/*manylinux_2_28*.whl
	$(BIN)/python scripts/check_wheel.py "$$(ls -t dist/*manylinux_2_28*.whl | head -1)"

clean: ## Remove what the other targets made
	rm -rf $(VENV) target dist out docs/build docs/generated

# The environment. Each stamp is newer than its sources.
$(VENV)/.made: scripts/make_venv.sh
	scripts/make_venv.sh $(PYTHON) $(VENV)
	touch $@

# The extension, built for a quick edit loop and as it is released. Each build replaces the other one.
$(VENV)/.built: $(SOURCES) | $(VENV)/.made
	@command -v cargo >/dev/null || { echo "cargo is missing: install Rust from https://rustup.rs" >&2; exit 1; }
	$(BIN)/maturin develop --profile develop --quiet
	rm -f $(VENV)/.released
	touch $@

$(VENV)/.released: $(SOURCES) | $(VENV)/.made
	$(BIN)/maturin develop --release --quiet
	rm -f $(VENV)/.built
	touch $@

$(VENV)/.lint: pyproject.toml | $(VENV)/.made
	$(BIN)/pip install --quiet --group lint
	touch $@

$(VENV)/.test: pyproject.toml scripts/system_packages.sh web/package-lock.json | $(VENV)/.made
	scripts/system_packages.sh test
	# The viewer's bundler and the driver of its browser; what needs them is skipped without Node.js, but not in CI.
	if command -v npm >/dev/null; then npm ci --prefix web --ignore-scripts --no-audit --no-fund --silent; fi
	$(BIN)/pip install --quiet --group test
	# pyrender pins a PyOpenGL that cannot draw without a screen; one call for both would walk back to an old pyrender.
	$(BIN)/pip install --quiet pyrender
	$(BIN)/pip install --quiet --no-deps PyOpenGL==3.1.10
	touch $@

$(VENV)/.long: pyproject.toml $(VENV)/.test
	$(BIN)/pip install --quiet --group long
	touch $@

$(VENV)/.docs: pyproject.toml | $(VENV)/.made
	$(BIN)/pip install --quiet --group docs
	touch $@

$(VENV)/.bench: pyproject.toml scripts/system_packages.sh | $(VENV)/.made
	scripts/system_packages.sh bench
	CPATH=/usr/include/eigen3 $(BIN)/pip install --quiet --group bench
	touch $@
