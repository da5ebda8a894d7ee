# Targets, from a bare checkout:
#
#   make demo            run the sample scene through the service (runtime only, no torch)
#   make test            run ruff, mypy and all tests, 40 minutes on two cores (ARGS=tests/service/splat for a part)
#   make lowest          run the tests with the lowest versions that pyproject.toml allows (ARGS=tests/service for a part).
#                        Needs Python 3.11 (PYTHON=python3.11): many of these versions are older than later releases of Python.
#   make evaluate        measure quality on held-out views, which takes minutes (ARGS=--check, for example)
#   make report          measure error against run time of every setting, and stability (ARGS=--quick)
#   make bench-splat     compare the splatter with a plain renderer (ARGS=--quick)
#   make compare-viewer  compare the splatter's pictures with those of a viewer (needs npm and Chromium)
#   make load            request pictures from a service while it reconstructs (ARGS="--minutes 10")
#   make image           build the container image
#   make image-check     build an image and use it as production would
#   make lock            update the pinned packages of the image
#
# All targets keep their environment in .venv (lowest: in .venv-lowest) and reuse it until pyproject.toml, setup.py or the
# viewer's lock file changes. pip's own settings apply: PIP_EXTRA_INDEX_URL, for example, can name an index that has the CPU
# build of torch.

PYTHON ?= python3
BIN := .venv/bin
BUILT_FROM := pyproject.toml setup.py service/viewer/package-lock.json
.PHONY: demo test lowest evaluate report bench-splat compare-viewer load image image-check lock clean

demo: .venv/.runtime
	$(BIN)/gapmes demo --output demo

# Containers often forbid bytecode: every process that a test starts would compile the whole project again.
test: export PYTHONDONTWRITEBYTECODE :=
test: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder --max-worker-restart 0 $(ARGS)

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
