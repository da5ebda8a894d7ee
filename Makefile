# Commands from a bare checkout: `make demo` (runtime only, no torch), `make test` (everything) and `make evaluate`
# (quality on held-out views, minutes; further options by ARGS, for example ARGS=--check). `make report` measures error
# against run time of every setting, and stability (ARGS=--quick). `make bench-splat` compares the
# splatter with a plain renderer (ARGS=--quick), `make compare-viewer` its pictures with those of a viewer (needs npm and
# Chromium). `make load` asks a service for pictures while it reconstructs (ARGS="--minutes 10"). `make image` builds the
# container image, `make image-check` builds one and uses it as production would, `make lock` pins anew what goes into it.
# `make lowest` runs the tests with the lowest versions that pyproject.toml allows (ARGS=tests/service for a part of them); it
# needs Python 3.11 (PYTHON=python3.11), as many of those versions are older than what came after it.
# All keep their environment in .venv (`lowest` one of its own in .venv-lowest) and reuse it until pyproject.toml, setup.py or
# the viewer's lock change. pip's own settings apply, for example PIP_EXTRA_INDEX_URL for an index that has the CPU build of
# torch.

PYTHON ?= python3
BIN := .venv/bin
BUILT_FROM := pyproject.toml setup.py service/viewer/package-lock.json
.PHONY: demo test lowest evaluate report bench-splat compare-viewer load image image-check lock clean

demo: .venv/.runtime
	$(BIN)/gapmes demo --output demo

test: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

lowest: .venv/.dev
	$(BIN)/python -m pip install --quiet uv
	tests/lowest $(BIN)/uv "$(PYTHON)" $(ARGS)

evaluate: .venv/.dev
	$(BIN)/gapmes evaluate --twice --out evaluation $(ARGS)

report: .venv/.dev
	$(BIN)/gapmes-export --report report --stability report $(ARGS)

bench-splat: .venv/.runtime
	$(BIN)/python -m benchmarks.splat.run $(ARGS)

compare-viewer: .venv/.runtime
	$(BIN)/python -m benchmarks.viewer.compare $(ARGS)

load: .venv/.runtime
	$(BIN)/python -m benchmarks.load.run $(ARGS)

image:
	docker build -f docker/Dockerfile -t gapmes-service .

image-check:
	docker/check

lock: .venv/.dev
	$(BIN)/python -m pip install --quiet uv
	docker/lock $(BIN)/uv

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "gapmes needs Python 3.11 or newer; set PYTHON=")'
	$(PYTHON) -m venv .venv

.venv/.runtime: $(BUILT_FROM) | .venv/bin/python
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

.venv/.dev: $(BUILT_FROM) | .venv/bin/python
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@touch .venv/.runtime $@

clean:
	rm -rf .venv .venv-lowest demo evaluation report build *.egg-info
