# `make` prints the targets. PYTHON=python3.12 chooses the interpreter of .venv (3.11 or later), and TORCH=torch==2.6.0 the
# build of PyTorch. The set-up is repeated only when pyproject.toml or a C++ source changes.
PYTHON ?= python3
TORCH ?= torch==2.13.0
VENV := .venv
BIN := $(VENV)/bin
COMPILED := $(shell find sgmethod/native -name "*.cpp" -o -name "*.h" -o -name CMakeLists.txt)
export CMAKE_BUILD_PARALLEL_LEVEL ?= $(shell nproc)
# Each worker of pytest has a core of its own, and threads that share one wait for each other. Hundreds of processes start:
# without Python's cache each would compile all that it imports anew.
PYTEST = PYTHONDONTWRITEBYTECODE= SG_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m pytest --quiet --numprocesses auto --dist loadfile

.PHONY: help serve quick test thorough coverage sanitize versions fuzz wheel npm demo lock bench

help:
	@sed -nE 's/^([a-z]+):[^#]*## (.*)/make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 16

serve: $(VENV)/.service ## set up, then run the service on http://127.0.0.1:8000 with its data in ./data
	$(BIN)/python -m service serve

# What needs neither PyTorch nor a service: reading pictures, coding, decoding.
QUICK = tests/fitting/test_texture.py tests/bitstream tests/paper/test_stream.py tests/paper/test_format.py tests/paper/test_decoder.py tests/io tests/test_decoder.py tests/test_view.py
quick: $(VENV)/.quick ## a first check in three minutes, without PyTorch: lint, format, types, tests of the codec
	$(BIN)/python -m ruff check .
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m mypy --package sgmethod.bitstream --package sgmethod.rd --package sgmethod.io
	$(PYTEST) -m "not thorough" $(QUICK)

test: $(VENV)/.test ## set up, then check lint, format and types, build the npm package if npm is installed, and run the tests
	$(BIN)/python -m ruff check .
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m mypy
	if command -v npm >/dev/null; then $(MAKE) npm; fi
	$(PYTEST) -m "not thorough"

thorough: $(VENV)/.test sanitize versions ## what a release needs besides `make test`: slow tests, sanitizers, another Python
	$(PYTEST) -m "thorough or hypothesis" --hypothesis-profile thorough

coverage: $(VENV)/.test ## report which lines and branches the tests of `make test` run
	$(PYTEST) -m "not thorough" --cov

MUTATIONS ?= 2000
sanitize: $(VENV)/.test ## run the kernels under sanitizers: their own tests, every golden file, MUTATIONS=n damaged ones
	$(BIN)/python -m tests.native.sanitize --mutations $(MUTATIONS) $(if $(SEED),--seed $(SEED))

VERSIONS ?= newest
versions: ## run tests that need no PyTorch on VERSIONS="3.12 3.13", or on the newest Python found
	.ci/versions $(VERSIONS)

MINUTES ?= 5
fuzz: $(VENV)/.test ## look for bytes that break the decoder, for MINUTES=n; needs Clang
	$(BIN)/python -m tests.native.fuzz --minutes $(MINUTES)

wheel: $(VENV)/.test ## build the source archive and a wheel in dist, check both, and decode with the wheel installed alone
	$(BIN)/python -m pip install --quiet build twine check-wheel-contents
	rm -rf dist build/wheel
	$(BIN)/python -m build --outdir dist
	$(BIN)/python -m twine check --strict dist/*
	$(BIN)/check-wheel-contents dist/*.whl
	$(BIN)/python -m venv build/wheel
	build/wheel/bin/python -m pip install --quiet --no-compile dist/*.whl
	build/wheel/bin/python tests/smoke.py

npm: ## build the npm package in dist, for browsers and Node
	$(INSTALL_NPM) && npm run --silent build && mkdir -p ../../dist && npm pack --silent --pack-destination ../../dist >packed
	@echo "Next, in the folder of your site: npm install $(CURDIR)/dist/$$(cat build/npm/packed) sharp"

demo: ## build the page on which anybody tries previews in build/demo: static files, for any server
	$(INSTALL_NPM) && node demo/build.mjs ../.. ../demo
	@echo 'Next, to open it in a browser: npx serve build/demo'

INSTALL_NPM = mkdir -p build/npm && cp -r sgmethod/javascript/. LICENSE build/npm/ && cd build/npm \
  && npm install --silent --no-audit --no-fund --no-package-lock

# Where PyTorch's CPU builds lie, which PyPI lacks for Linux.
TORCH_WHEELS ?= https://download.pytorch.org/whl/cpu/torch/
BUILD_REQUIREMENTS = import tomllib; \
  print(*tomllib.load(open("pyproject.toml", "rb"))["build-system"]["requires"], sep="\n")
LOCKED = service/requirements
LOCK = $(BIN)/uv pip compile --quiet --upgrade --universal --python-version 3.11 --generate-hashes --no-annotate \
  --custom-compile-command 'make lock' --no-emit-index-url
lock: $(VENV)/.service ## renew versions and hashes of what the image installs, in service/requirements
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/python -c '$(BUILD_REQUIREMENTS)' | $(LOCK) - --output-file $(LOCKED)/build.txt
	$(LOCK) pyproject.toml --extra service --extra postgres --extra s3 --output-file $(LOCKED)/slim.txt
	echo '$(TORCH)+cpu' | $(LOCK) - pyproject.toml --extra torch --constraint $(LOCKED)/slim.txt \
	  --find-links $(TORCH_WHEELS) --emit-find-links --output-file $(LOCKED)/torch.txt

bench: $(VENV)/.benchmark ## some measurements in ten minutes, or nearly all with FULL=yes and IMAGES, PHOTOGRAPHS and WEIGHTS
	$(BIN)/python -m benchmarks $(if $(FULL),--full) $(if $(IMAGES),--images $(IMAGES)) $(if $(WEIGHTS),--weights $(WEIGHTS)) \
	  $(if $(PHOTOGRAPHS),--photographs $(PHOTOGRAPHS))

# The stamp is written last: a set-up that was interrupted is taken up again by the next call. PyTorch, which the service
# does without, comes first, so that its build is the one chosen; Python compiles a module when it is first imported, and
# most of PyTorch never is. Kernels that an installation has compiled since the last change need only the packages.
INSTALLED = $(wildcard $(VENV)/lib/python*/site-packages/_editable_skbc_sgmethod.py)
COMPILES = $(if $(INSTALLED),$(shell find $^ -newer $(firstword $(INSTALLED))),yes)
$(VENV)/.%: pyproject.toml $(COMPILED)
	@$(CHECK)
	@echo 'Setting up $(VENV): installing packages$(if $(COMPILES), and compiling the kernels: about two minutes) ...'
	$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	$(if $(filter service quick,$*),,$(BIN)/python -m pip install --quiet --no-compile '$(TORCH)')
	$(BIN)/python -m pip install --quiet --no-compile $(if $(COMPILES),--editable .,sgmethod)'[$*,heif]'
	touch $@ $(if $(filter test,$*),$(VENV)/.service)

# Names the Debian or Ubuntu packages that are missing before anything is downloaded or built.
NAME := $(notdir $(PYTHON))
define CHECK
command -v $(PYTHON) >/dev/null && $(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
  && $(PYTHON) -c 'import ensurepip, pathlib, sys, sysconfig, venv; \
    sys.exit(not pathlib.Path(sysconfig.get_path("include"), "Python.h").exists())' 2>/dev/null \
  && command -v $(CXX) >/dev/null \
  || { echo "The set-up needs Python 3.11 or later with its headers, and a C++ compiler:" \
       "sudo apt install $(NAME) $(NAME)-venv $(NAME)-dev g++" >&2; exit 1; }
endef
